"""Pictures of runs: the overview, the road around the ego, and clips of it."""
