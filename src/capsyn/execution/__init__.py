"""Files, processors, memory, answers that are kept, and workers of a cluster."""
