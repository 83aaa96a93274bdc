"""Policies under names of their own: policy `litsim` with other parameters, each a YAML file of this folder."""
