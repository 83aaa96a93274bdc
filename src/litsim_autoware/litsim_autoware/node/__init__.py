"""The node between the ego port and Autoware: its clock, what Autoware reads of a step, and what it commands."""
