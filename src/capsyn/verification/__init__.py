"""Evidence for policies, one module per kind."""
