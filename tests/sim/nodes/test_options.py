"""Parameters of the bridge: their defaults, what they make of a scenario, and what is refused before a run begins."""

import json
from typing import Any

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.nodes.options import BridgeOptions, bridge_stage
from litsim_sim.scenario.scenario import Scenario


def options(**values: Any) -> BridgeOptions:
    read = ParameterOverrides("bridge", values)
    made = bridge_stage(read)
    read.check()
    return made


def test_without_parameters_the_packaged_scenario_is_run_as_it_says() -> None:
    made, scenario = options(), Scenario.load("demo")
    plan = made.plan()
    assert (plan.scenario.name, plan.ego, plan.policy) == ("demo", "idm", "litsim")
    assert (plan.scenario.ego_id, plan.scenario.seed) == (scenario.ego_id, scenario.seed)
    assert plan.scenario.vehicle == scenario.vehicle
    assert (made.mode, made.on_missing, made.on_invalid, made.progress) == ("lockstep", "stop", "stop", "bar")


def test_ego_seed_and_vehicle_replace_those_of_the_scenario() -> None:
    before = Scenario.load("demo")
    other = int(before.log.table(0).id[0])
    assert other != before.ego_id
    plan = options(ego_id=other, seed=17, ego="log", policy="replay", **{"vehicle.lag_s": 0.25}).plan()
    assert (plan.scenario.ego_id, plan.scenario.seed) == (other, 17)
    assert (plan.scenario.vehicle.lag_s, plan.scenario.vehicle.delay_s) == (0.25, before.vehicle.delay_s)
    assert plan.stages == ("ego", "recorder")


def test_small_numbers_of_stages_are_numbers_as_json_writes_them() -> None:
    made = options(stage_parameters=json.dumps({"conflict": {"urgent_time": 1e-05}}))
    assert made.plan().parameters == {"conflict": {"urgent_time": 1e-05}}


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"mode": "fast"}, "lockstep"),
        ({"ego": "nobody"}, "idm"),
        ({"policy": "nice"}, "litsim"),
        ({"on_missing": "wait"}, "hold"),
        ({"ego_interface": "speech"}, "twist"),
        ({"progress": "much"}, "lines"),
        ({"answer_timeout_s": 0.0}, "expected a number of more than 0 [s]"),
        ({"handshake_timeout_s": -1.0}, "expected a number of more than 0 [s]"),
        ({"external_timeout_s": float("inf")}, "expected a number of more than 0 [s]"),
        ({"seed": -2}, "-1"),
        ({"vehicle.lag_s": -0.5}, "lag_s"),
    ],
)
def test_what_is_out_of_range_is_named_with_what_was_expected(values: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError) as raised:
        options(**values)
    (name,) = values
    said = str(raised.value)
    assert said.startswith("bridge: ")
    assert name in said and expected in said
    assert "\n" not in said


def test_a_vehicle_that_is_not_in_the_recording_is_refused() -> None:
    with pytest.raises(InputError, match="4711"):
        options(ego_id=4711).plan()
