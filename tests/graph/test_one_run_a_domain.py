"""Two runs at once on one domain: one of them is refused, and the other goes on as if nothing had been."""

from pathlib import Path
from typing import Any

from patience import wait_for

EXTERNAL = ("--ego", "external", "--policy", "replay", "--set", "bridge.external_timeout_s=200.0")


def start(graph: Any, out: Path) -> Any:
    """A launched run that waits for its ego."""
    words = ("--scenario", graph.scenario(), "--out", out, "--domain-id", graph.domain)
    return graph.start_launch(*words, *EXTERNAL)


def test_of_two_bridges_on_a_domain_one_refuses(graph: Any, tmp_path: Path) -> None:
    """The second is as of another user or machine, whose locks are elsewhere.

    It looks for other runs before it begins. Where the machine is so busy that it finds none in that time, the first
    one hears it begin, and ends.
    """
    first = start(graph, graph.folder / "first")
    wait_for("the first run", lambda: "waiting for " in log(graph.folder / "first"))
    elsewhere = {"ROS_DOMAIN_ID": str(graph.domain), "XDG_RUNTIME_DIR": str(tmp_path), "LITSIM_DOMAIN_HOLDER": ""}
    parameters = {"scenario": graph.scenario(), "ego": "external", "policy": "replay", "progress": "none"}
    parameters["handshake_timeout_s"] = "30.0"
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    bridge = graph.start_program("litsim_sim", "bridge", "--ros-args", *given, **elsewhere)
    refused = graph.finish(bridge)
    assert refused.returncode == 1
    graph.start_script("standard_ego.py")
    done = graph.finish(first)
    found = "error: another bridge "
    assert found in refused.stderr or found in done.stderr


def log(out: Path) -> str:
    path = out / "log/bridge.log"
    return path.read_text() if path.is_file() else ""
