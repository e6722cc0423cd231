"""Straight-line programs as plain data, and what is known of them."""
