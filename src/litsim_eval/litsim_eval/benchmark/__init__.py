"""Benchmarks: what a step, a forecast, the start and a campaign cost."""
