"""The paper's baselines as policies of the background: IDM, GAIL, RAIL and SimNet."""
