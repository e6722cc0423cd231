"""Proofs about sampled loops: what arrives, stays and avoids from a whole set of starts."""
