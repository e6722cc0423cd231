"""Placeholder."""


def formulas(policy):
    return ""
