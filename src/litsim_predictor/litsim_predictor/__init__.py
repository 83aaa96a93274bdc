"""Joint predictors, kinematic and learned, and their node."""
