"""The paper's baselines as policies of the background: IDM, GAIL, RAIL and SimNet."""

BASELINES = ("idm", "gail", "rail", "simnet")
"""Their names, in the order of the paper's tables."""
