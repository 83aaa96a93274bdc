"""Scenario mining: events around every possible ego in recorded traffic, their measures, and selections of them."""
