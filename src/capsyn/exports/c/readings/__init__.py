"""How readings become steps of the lattice, in C."""
