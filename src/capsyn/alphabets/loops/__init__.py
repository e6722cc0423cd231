"""Closed loops of sSAC without cells, under many alphabets at once."""
