"""Evaluation: runs in process, campaigns, measures, reports, check of a stack, and benchmarks."""
