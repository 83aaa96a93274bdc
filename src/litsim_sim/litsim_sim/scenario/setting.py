"""What the stages of a run take as their scenario: a single one, or a batch of several."""

from __future__ import annotations

from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.scenario.scenario import Scenario

Setting = Scenario | BatchedScenario
"""Stages use the attributes that both have; arrays of shape (scenes, ...) have one entry for a single scenario."""
