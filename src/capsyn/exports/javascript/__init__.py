"""Policies in JavaScript."""
