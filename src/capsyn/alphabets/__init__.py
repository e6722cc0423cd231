"""Which symbols to have: candidates, and the choice of an alphabet among them."""
