"""Commands that prove what a loop does, and check what was proved."""
