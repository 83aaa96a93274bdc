"""Exports: runs, scenarios, recordings and nets in the formats of other tools."""
