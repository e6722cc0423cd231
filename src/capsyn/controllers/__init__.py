"""Sequential action control: sSAC for batches of states, whole actions, and online."""
