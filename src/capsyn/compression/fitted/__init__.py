"""Trees of oblique splits that are fitted to a controller."""
