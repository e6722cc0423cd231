"""The search among alphabets: starts, exchange, symbols that move, what was found."""
