"""The stages that the packages register, and their parameters checked before a run."""

from typing import Any

import pytest

from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.plugins import configured_stages
from litsim_sim.core.stages import POLICY_STAGES
from litsim_sim.scenario.run_info import driver_names

STAGES = ("bridge", "recorder", *POLICY_STAGES, "ego")
EGO = "perturbed"


def test_every_stage_of_every_run_is_registered() -> None:
    assert set(plugins.names(plugins.STAGES)) == {"bridge", "recorder", *POLICY_STAGES}
    for ego in driver_names():
        assert set(configured_stages(STAGES, {}, ego)) == set(STAGES)


def test_parameters_of_every_stage_are_taken() -> None:
    given: dict[str, dict[str, Any]] = {
        "bridge": {"answer_timeout_s": 2, "vehicle.delay_s": 0.2},
        "recorder": {"overwrite": True},
        "predictor": {"kinematic.horizon": 2, "model": "kinematic"},
        "conflict": {"horizon": 2, "handback": "catch_up"},
        "policy": {"safety.horizon": 2, "rules": False},
        "ego": {"time": (0, 1)},
    }
    bridge = configured_stages(STAGES, given, EGO)["bridge"]
    assert bridge.answer_timeout_s == 2.0 and bridge.vehicle.delay_s == 0.2


@pytest.mark.parametrize(
    ("stage", "name", "value", "said"),
    [
        (
            "conflct",
            "horizon",
            2.0,
            r"no stage of this run: conflct \(near: conflict\); expected bridge, conflict, ego, ",
        ),
        ("conflict", "horizn", 2.0, r"conflict: unknown parameter horizn \(near: horizon\); expected approach_time, "),
        (
            "conflict",
            "horizon",
            -1,
            r"conflict: parameter horizon is -1, expected a number of at least 0.1 and at most ",
        ),
        (
            "predictor",
            "kinematic.dt",
            1e-9,
            r"parameter kinematic.dt is 1e-09, expected a number of at least 0.001 \[s\]",
        ),
        ("ego", "lane_change_time", 1e9, r"lane_change_time is 1000000000.0, expected a number of more than 0 and "),
        ("conflict", "confirm_steps", 10**12, r"expected a whole number of more than 0 and at most 36000 "),
        (
            "conflict",
            "probability_clear",
            0.4,
            "conflict: parameter probability_clear is 0.4, expected at most probability_threshold, which is 0.3",
        ),
        (
            "policy",
            "safety.braking_max",
            0,
            r"policy: parameter safety.braking_max is 0, expected a number of more than 0 \[",
        ),
        (
            "ego",
            "time",
            [1.0],
            r"time is \[1.0\], expected a list of 2, each a number of at least 0 ",
        ),
        ("predictor", "model", "seer", "predictor: parameter model is 'seer', expected one of bat, cs_lstm, default, "),
        ("ego", "time", (3, 1), r"ego: parameter time is \(3.0, 1.0\), expected the earliest before the latest"),
        ("bridge", "mode", "fast", "bridge: parameter mode is 'fast', expected one of lockstep, realtime"),
        (
            "bridge",
            "ego",
            "ghost",
            "bridge: parameter ego is 'ghost', expected one of bat, idm, log, onnx, perturbed, track, external",
        ),
        ("bridge", "vehicle.delay_s", 0.25, "bridge: parameter vehicle.delay_s is 0.25, expected a multiple of 0.1 s"),
        ("recorder", "overwrite", 1, "recorder: parameter overwrite is 1, expected true or false"),
    ],
)
def test_what_cannot_be_is_said(stage: str, name: str, value: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        configured_stages(STAGES, {stage: {name: value}}, EGO)


def test_a_stage_that_no_package_has() -> None:
    with pytest.raises(InputError, match="no installed package has a stage ghost"):
        configured_stages(("ghost",), {})
    with pytest.raises(
        InputError, match="no installed package has ghost; expected bat, idm, log, onnx, perturbed, track"
    ):
        configured_stages(("ego",), {}, "ghost")
