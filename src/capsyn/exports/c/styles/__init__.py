"""The forms that a lookup in C can have."""
