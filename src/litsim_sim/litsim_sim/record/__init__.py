"""Recordings of runs: bags, written, read as arrays, repaired and played; and digests."""
