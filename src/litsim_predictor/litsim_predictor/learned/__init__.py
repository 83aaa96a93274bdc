"""Learned joint predictors: data, models, training and inference."""

SHIPPED = ("default", "paper", "cs_lstm", "bat")
"""Names of the models whose weights come with the package; known without torch."""
