"""Policies in Structured Text, IEC 61131-3."""
