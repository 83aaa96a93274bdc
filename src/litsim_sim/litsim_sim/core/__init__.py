"""Shared definitions: tables of agents, boxes, vehicle dynamics, steps, parameters, errors."""
