"""Partitions of a domain: grids of cells, trees of splits, affine leaves."""
