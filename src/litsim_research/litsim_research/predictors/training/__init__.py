"""Training of learned predictors: its configuration, its data, the training itself, and its learning curves."""
