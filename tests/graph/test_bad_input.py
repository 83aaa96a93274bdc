"""What cannot work is refused in one line that says where and what was expected; nobody waits for ever."""

from __future__ import annotations

import signal
from typing import Any

import pytest

HANDSHAKE_S = 15.0  # for the others, which have been started, to get ready, however busy the machine is


@pytest.mark.parametrize(
    ("program", "arguments", "expected"),
    [
        (
            ("litsim_policy", "conflict"),
            ("-p", "rio:=3.0"),
            "conflict: unknown parameter rio (near: region, horizon); expected approach_time, ",
        ),
        (("litsim_policy", "ego"), ("--fast",), "ego: unknown argument"),
    ],
)
def test_parameters(graph: Any, program: tuple[str, str], arguments: tuple[str, ...], expected: str) -> None:
    done = graph.finish(graph.start_node(*program, *arguments))
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert expected in line


def start_graph(graph: Any, *, broken: bool = False, **bridge: Any) -> tuple[Any, Any, dict[str, Any]]:
    """Every node one by one, but without a conflict stage, or with a `broken` one: bridge, recorder, stages."""
    programs = {
        "predictor": ("litsim_predictor", "predictor"),
        "policy": ("litsim_policy", "policy"),
        "ego": ("litsim_policy", "ego"),
    }
    stages = {name: graph.start_node(*program) for name, program in programs.items()}
    if broken:
        stages["conflict"] = graph.start_script("broken_stage.py")
    recorder = graph.start_node("litsim_sim", "recorder", output=graph.folder / "run")
    for node in (*stages.values(), recorder):
        assert "waiting for a run on /litsim/run_info" in node.stderr.readline()
    parameters = {"scenario": graph.scenario(), "progress": "none"} | bridge
    return graph.start_node("litsim_sim", "bridge", **parameters), recorder, stages


def error_of(graph: Any, bridge: Any) -> str:
    """The one error of a bridge that gave up."""
    done = graph.finish(bridge)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    return line


def test_stage_that_is_not_there_is_named(graph: Any) -> None:
    bridge, recorder, stages = start_graph(graph, handshake_timeout_s=HANDSHAKE_S)
    line = error_of(graph, bridge)
    assert line.startswith("error: conflict: no READY for run short-idm-litsim-13-0-")
    assert line.endswith(
        f" on /litsim/status within {HANDSHAKE_S:g} s; is the node running in ROS_DOMAIN_ID {graph.domain}?"
    )
    assert graph.finish(recorder).returncode == 0
    assert all(stage.poll() is None for stage in stages.values())  # they wait for the next run


def test_stage_that_fails_is_quoted_in_one_line(graph: Any) -> None:
    bridge, recorder, stages = start_graph(graph, broken=True)
    line = error_of(graph, bridge)
    assert line.startswith("error: conflict: step 5: ZeroDivisionError: ")
    assert "(broken_stage.py, line " in line
    assert graph.finish(recorder).returncode == 0
    status, said = graph.end(stages["conflict"], signal.SIGINT)
    assert status == 0
    assert said.count("Traceback") == 1  # in the log of the stage alone


def test_nodes_alone_end_at_once(graph: Any) -> None:
    for program, number, expected in (
        (("litsim_sim", "bridge"), signal.SIGINT, 130),
        (("litsim_sim", "recorder"), signal.SIGINT, 130),
        (("litsim_policy", "conflict"), signal.SIGTERM, 0),
    ):
        node = graph.start_node(*program)
        assert "waiting for " in node.stderr.readline()
        status, said = graph.end(node, number)
        assert status == expected
        assert "Traceback" not in said
