"""Policies in other languages, one module per target."""
