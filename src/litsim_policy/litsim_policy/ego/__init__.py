"""Egos that come with LitSim; any other stack can take their place on the ego port."""
