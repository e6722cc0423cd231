"""The paper's cases, figures and numbers."""
