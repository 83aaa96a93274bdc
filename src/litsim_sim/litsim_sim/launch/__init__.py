"""Processes of a graph: the executables, and the DDS domain that they share."""
