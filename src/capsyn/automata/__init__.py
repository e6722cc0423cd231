"""Which symbols follow which: policies as finite automata."""
