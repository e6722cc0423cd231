"""Compiled kernels: programs as C lanes inside hand-written loops, called through ctypes."""
