"""From a problem to a policy."""
