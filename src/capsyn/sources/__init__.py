"""Controllers beside sSAC that become policies: callables, predictive control, tables."""
