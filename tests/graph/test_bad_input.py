"""What cannot work is refused in one line that says where and what was expected; nobody waits for ever."""

import signal
from typing import Any

import pytest

HANDSHAKE_S = 10.0  # for the recorder, which has been started, to get ready, however busy the machine is


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


def run_of(graph: Any, name: str, **bridge: Any) -> str:
    """The one error of a bridge that gives up; its recorder ends well."""
    recorder = graph.start_node("litsim_sim", "recorder", output=graph.folder / name)
    assert "waiting for a run on /litsim/run_info" in recorder.stderr.readline()
    parameters = {"scenario": graph.scenario(), "policy": "replay", "progress": "none"} | bridge
    done = graph.finish(graph.start_node("litsim_sim", "bridge", **parameters))
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert graph.finish(recorder).returncode == 0
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    return line


def test_a_stage_that_is_not_there_is_named_and_one_that_fails_is_quoted_in_one_line(graph: Any) -> None:
    line = run_of(graph, "without", handshake_timeout_s=HANDSHAKE_S)
    assert line.startswith("error: ego: no READY for run short-idm-replay-13-0-")
    assert line.endswith(
        f" on /litsim/status within {HANDSHAKE_S:g} s; is the node running in ROS_DOMAIN_ID {graph.domain}?"
    )
    ego = graph.start_script("broken_stage.py")
    line = run_of(graph, "broken")
    assert line.startswith("error: ego: step 5: ZeroDivisionError: ")
    assert "(broken_stage.py, line " in line
    status, said = graph.end(ego, signal.SIGINT)
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
