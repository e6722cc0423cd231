"""Policies as functional mock-up units."""
