"""What policy C is punished for: every term by its own weight."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from litsim_policy.learning.reward import Penalties, PenaltyConfig

TERMS = tuple(field.name for field in fields(PenaltyConfig))
ONCE = ("collision", "off_road")
LASTING = tuple(name for name in TERMS if name not in ONCE)
WEIGHTS = PenaltyConfig(**{name: 2.0 + k for k, name in enumerate(TERMS)})


def total(**values: float) -> float:
    """The penalty of one agent with these terms, the others 0."""
    terms = {field.name: np.array([values.get(field.name, 0.0)]) for field in fields(Penalties)}
    return float(Penalties(**terms).total(WEIGHTS)[0])


def test_every_weight_has_its_term() -> None:
    assert tuple(field.name for field in fields(Penalties)) == TERMS
    assert all(getattr(PenaltyConfig(), name) > 0.0 for name in TERMS)


@pytest.mark.parametrize("name", TERMS)
def test_every_term_counts_by_its_weight(name: str) -> None:
    assert total() == 0.0
    assert total(**{name: 1.0}) == -getattr(WEIGHTS, name)


def test_of_those_that_last_the_worst_counts_and_what_ends_the_episode_comes_on_top() -> None:
    worst = max(getattr(WEIGHTS, name) for name in LASTING)
    assert total(**dict.fromkeys(LASTING, 1.0)) == -worst
    once = sum(getattr(WEIGHTS, name) for name in ONCE)
    assert total(**dict.fromkeys(TERMS, 1.0)) == -(worst + once)
    assert total(edge=0.5) == pytest.approx(-0.5 * WEIGHTS.edge)
