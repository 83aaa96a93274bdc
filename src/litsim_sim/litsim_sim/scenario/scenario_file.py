"""The fields of a scenario's YAML file."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator

from litsim_sim.core.scene import STEP_S
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.scenario.changes import Change
from litsim_sim.scenario.signals import SignalsFile

SEEDS = 2**64  # range of the field in RunInfo


def usable_name(name: str) -> str:
    """Returns `name`; raises ValueError, with what is expected, if it is no valid name of a scenario."""
    if not re.fullmatch(r"\w[\w.+=-]{0,99}", name):
        raise ValueError(
            "expected up to 100 letters, digits and . _ + = -, the first a letter or digit: folders are named so"
        )
    return name


def _usable_path(path: str) -> str:
    if not path or not path.isprintable():
        raise ValueError("expected the path of a file")
    return path


_Path = Annotated[str, AfterValidator(_usable_path)]
DAY_S = 86_400.0  # [s] longest time of a scenario
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_SignalsField = Annotated[
    Annotated[_Path, Tag("file")] | Annotated[SignalsFile, Tag("content")],
    Discriminator(lambda value: "file" if isinstance(value, str) else "content"),
]


class ScenarioFile(BaseModel):
    """The fields of a scenario's YAML file.

    Attributes:
        name: short name; runs, reports and folders carry it.
        description: what happens in it.
        recording: file of the recording, relative to the YAML file; may begin with ``$LITSIM_DATA``.
        crop: the [low, high] to keep, by column of that file.
        net: SUMO net, relative to the YAML file, or the name of a packaged net.
        start_frame: frame of step 0; the first of the recording if not given.
        history_s: recorded past before the ego is free [s]; at least one step, like `simulation_s`.
        simulation_s: simulated time after that [s]; cut at the end of the recording.
        ego: id of the vehicle that the driving system under test moves.
        goal: pose at which the ego's box centre is to arrive, [x, y, yaw] in frame map [m, m, rad]; default: where its
            log ends.
        egos: ids of the egos of experiments, one run each.
        tuning: ids of egos for tuning a system before such an experiment; disjoint from `egos`.
        roi_m: radius around the ego, and around every other agent off its log, within which agents are forecast and may
            be taken over [m].
        seed: seed of all randomness.
        draw: number of the draw of the background's drivers, where a policy draws them: with another number, other
            drivers meet the same ego.
        signals: file of the signals, relative to the YAML file, or its content, see :class:`SignalsFile`; default:
            those of the recording, if it has signals of this net.
        end_after_contact_s: time after the ego's first contact at which the run ends [s], rounded to a step; null: it
            continues. Contacts with agents that touch the ego in the log as well do not count.
        coverage_min: smallest share, from 0 to 1, of the recorded box centres that must lie on lanes of the net.
        vehicle: fields of :class:`litsim_sim.core.vehicle.VehicleModel` of the ego that differ from the defaults.
        changes: what differs from the recording, see :mod:`litsim_sim.scenario.changes`.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    name: Annotated[str, AfterValidator(usable_name)]
    description: str = ""
    recording: _Path
    crop: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] | None = None
    net: _Path
    start_frame: int | None = None
    history_s: Annotated[_Finite, Field(ge=STEP_S, le=DAY_S)] = 3.0
    simulation_s: Annotated[_Finite, Field(ge=STEP_S, le=DAY_S)] = 25.0
    ego: int
    goal: Annotated[list[_Finite], Field(min_length=3, max_length=3)] | None = None
    egos: list[int] = []
    tuning: list[int] = []
    roi_m: Annotated[_Finite, Field(gt=0)] = 30.0
    seed: Annotated[int, Field(ge=0, lt=SEEDS)] = 0
    draw: Annotated[int, Field(ge=0, lt=SEEDS)] = 0
    signals: _SignalsField | None = None
    end_after_contact_s: Annotated[_Finite, Field(ge=0, le=DAY_S)] | None = None
    coverage_min: Annotated[_Finite, Field(ge=0, le=1)] = 0.9
    vehicle: dict[str, _Finite] = {}
    changes: list[Change] = []

    @field_validator("vehicle")
    @classmethod
    def _check_vehicle(cls, values: dict[str, float]) -> dict[str, float]:
        VehicleModel.of(values)
        return values
