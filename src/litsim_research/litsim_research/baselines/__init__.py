"""Baselines as policies of the background: the paper's IDM, GAIL, RAIL and SimNet, and a predictor in closed loop."""
