"""Campaigns: a suite of cases, criteria, a verdict on each run, the folder of results, two campaigns compared."""
