"""Commands that make a policy better."""
