"""The measures of a run, one module a family, and what several of them need."""
