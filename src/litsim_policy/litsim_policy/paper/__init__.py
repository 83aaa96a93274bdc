"""The paper's experiments: its tables, ablations and figures, each a campaign and what is made of its results."""
