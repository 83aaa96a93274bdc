"""Ego drivers of LitSim; an external stack can take their place at the ego port."""
