"""Recordings of runs: bags, written, read as arrays and played; and digests."""
