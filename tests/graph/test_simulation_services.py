"""A client of simulation_interfaces pauses a run and makes steps; the run is that which was not disturbed."""

import json
from collections.abc import Callable
from typing import Any

import pytest

from patience import wait_for

pytest.importorskip("simulation_interfaces", reason="simulation_interfaces is not built (tools/interfaces.sh)")

from simulation_interfaces import msg, srv

from observer import Observer


def test_a_run_pauses_and_goes_on(graph: Any, recorded: Callable[..., Any]) -> None:
    undisturbed = recorded("idm", "litsim")
    bag = graph.folder / "run"
    setup = ("--scenario", graph.scenario(), "--ego", "idm", "--policy", "litsim", "--out", bag)
    process = graph.start_launch(*setup, "--domain-id", graph.domain)
    with Observer(graph.domain) as client:

        def call(kind: Any, name: str, **fields: Any) -> Any:
            return client.call(kind, f"/litsim/{name}", kind.Request(**fields))

        def set_state(state: int) -> int:
            wanted = msg.SimulationState(state=state)
            return int(call(srv.SetSimulationState, "set_simulation_state", state=wanted).result.result)

        def states() -> list[Any]:
            return list(call(srv.GetEntitiesStates, "get_entities_states").states)

        assert set_state(msg.SimulationState.STATE_PAUSED) == msg.Result.RESULT_OK
        wait_for("step 0", lambda: len(states()) == 40)
        before = step_of(states())
        assert call(srv.StepSimulation, "step_simulation", steps=3).result.result == msg.Result.RESULT_OK
        assert step_of(states()) == before + 3
        assert set_state(msg.SimulationState.STATE_PLAYING) == msg.Result.RESULT_OK
        done = graph.finish(process)
    assert done.returncode == 0, done.stderr
    digests = [json.loads((each / "metrics.json").read_text())["digest"] for each in (bag, undisturbed.bag)]
    assert digests[0] == digests[1]


def step_of(states: list[Any]) -> int:
    stamp = states[0].header.stamp
    return int(stamp.sec * 10 + stamp.nanosec // 10**8)


def test_scenarios_are_served_one_after_the_other(graph: Any, recorded: Callable[..., Any]) -> None:
    """Load, play, reset and unload: each whole run is recorded, and equal to one that was launched."""
    undisturbed, out, playing = recorded("idm", "litsim"), graph.folder / "served", msg.SimulationState.STATE_PLAYING
    options = ("--ego", "idm", "--policy", "litsim", "--answer-timeout", "60")
    where = ("--worlds", graph.folder)
    server = graph.start_program("litsim_sim", "serve", "--domain-id", graph.domain, "--out", out, *where, *options)
    with Observer(graph.domain) as client:

        def call(kind: Any, name: str, **fields: Any) -> Any:
            return client.call(kind, f"/litsim/{name}", kind.Request(**fields))

        def load(uri: str) -> Any:
            return call(srv.LoadWorld, "load_world", world_resource=msg.Resource(uri=uri))

        def play(number: int) -> None:
            """Lets a run go on to its end."""
            state = call(srv.GetSimulationState, "get_simulation_state").state.state
            assert state == msg.SimulationState.STATE_PAUSED
            wanted = msg.SimulationState(state=playing)
            done = call(srv.SetSimulationState, "set_simulation_state", state=wanted).result.result
            assert done == msg.Result.RESULT_OK
            wait_for("its measures", (out / f"{number:03}/metrics.json").is_file)

        refused = load("nowhere")
        assert refused.result.result == refused.RESOURCE_PARSE_ERROR
        assert "'nowhere': no such scenario" in refused.result.error_message
        nothing = call(srv.UnloadWorld, "unload_world")
        assert nothing.result.result == nothing.NO_WORLD_LOADED
        loaded = load(str(graph.scenario()))
        assert (loaded.result.result, loaded.world.name) == (msg.Result.RESULT_OK, "short"), loaded.result
        play(0)
        assert call(srv.ResetSimulation, "reset_simulation").result.result == msg.Result.RESULT_OK
        play(1)
        assert load("demo").result.result == msg.Result.RESULT_OK
        assert call(srv.GetCurrentWorld, "get_current_world").world.name == "demo"
        assert call(srv.UnloadWorld, "unload_world").result.result == msg.Result.RESULT_OK
    status, _ = graph.end(server)
    assert status == 0 and not graph.running()
    digests = [json.loads((bag / "metrics.json").read_text())["digest"] for bag in (out / "000", out / "001")]
    assert digests == [json.loads((undisturbed.bag / "metrics.json").read_text())["digest"]] * 2
