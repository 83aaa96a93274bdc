"""What every stage speaks of: tables of agents, boxes, vehicle dynamics, steps, parameters, errors."""
