"""The C compiler, the cache of what it built, and C around programs as lanes."""
