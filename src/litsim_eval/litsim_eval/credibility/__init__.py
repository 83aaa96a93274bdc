"""Credibility: how simulated agents react in recorded encounters, beside what people did."""
