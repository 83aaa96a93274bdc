"""The policy stage: how agents that are off their log drive."""
