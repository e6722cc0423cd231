"""Policies in JSON, with a schema."""
