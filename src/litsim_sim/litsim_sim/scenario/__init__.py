"""Scenarios (a recording, a net and an ego), their logs, and plans of runs."""
