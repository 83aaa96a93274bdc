"""Runs in process, campaigns of runs, reruns from records, and benchmarks."""
