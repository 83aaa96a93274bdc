"""The paper's experiments: tables, ablations and figures, each made from the results of a campaign."""
