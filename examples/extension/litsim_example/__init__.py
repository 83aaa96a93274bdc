"""A policy, a measure and a format of recordings for LitSim."""
