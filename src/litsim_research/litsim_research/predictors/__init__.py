"""Learned joint predictors, by torch: data, models, training, evaluation and export; see :mod:`..inference`."""
