"""The best that an alphabet allows: dynamic programming on a grid of states."""
