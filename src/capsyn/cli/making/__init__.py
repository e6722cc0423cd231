"""The command that makes policies."""
