"""Policies in C."""
