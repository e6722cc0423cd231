"""Reach sets of sampled loops: enclosures of all solutions, as pieces cut at labels."""
