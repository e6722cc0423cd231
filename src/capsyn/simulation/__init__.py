"""Closed loops of any controller and any plant, at a sample rate."""
