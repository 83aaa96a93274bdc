"""Autoware at the ego port: its topics and services, both ways, by a node beside the stack."""
