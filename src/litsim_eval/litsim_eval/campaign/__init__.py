"""Campaigns: suites of cases, criteria, verdicts on runs, folders of results, and comparisons of two campaigns."""
