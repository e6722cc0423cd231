"""Policies in Verilog."""
