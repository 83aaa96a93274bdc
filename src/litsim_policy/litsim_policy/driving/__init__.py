"""The policy stage: policies that drive the agents off their logs."""
