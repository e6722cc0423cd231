"""Algorithm 1 of the paper: adaptive cell subdivision, over any labelling function."""
