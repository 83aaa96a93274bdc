"""The bars: what a background has to reach to be called credible, fixed before it was measured."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from litsim_eval.campaign.criteria import CriterionResult, Limits
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.scenario import packaged

BARS_FILE = "bars.yaml"


class Bars(BaseModel):
    """Limits on the measures of a policy."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    bars: Annotated[list[Limits], Field(min_length=1)]


def bars_path() -> Path:
    """Returns the packaged file of the bars."""
    return packaged(f"credibility/{BARS_FILE}", "litsim_eval")


@cache
def bars() -> tuple[Limits, ...]:
    """Returns the packaged bars."""
    return tuple(read_yaml(bars_path(), Bars).bars)


def judged(figures: Mapping[str, Any]) -> list[CriterionResult]:
    """Returns the verdict of each bar on the measures of a policy, as in `credibility.json`.

    Bars on drawn drivers are left out where none were drawn.
    """
    return [bar.judge(figures.get(bar.field)) for bar in bars() if bar.field in figures]
