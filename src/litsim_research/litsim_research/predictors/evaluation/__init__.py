"""Evaluation of forecasts: errors, likelihoods, predicted conflicts."""
