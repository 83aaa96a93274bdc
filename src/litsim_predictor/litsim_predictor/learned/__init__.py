"""Learned joint predictors: data, models, training and inference."""
