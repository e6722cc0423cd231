"""Limits that a sampled loop keeps from every state of a set."""
