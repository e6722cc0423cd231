"""States that have no finite solution: why, and what stands for one at single points."""
