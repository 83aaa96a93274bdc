"""Kernels: functions that are compiled to machine code, kept on disk."""
