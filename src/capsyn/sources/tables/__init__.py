"""Readers of tables that other tools write, a format or one part of reading it a file."""
