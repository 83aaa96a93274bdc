"""``ros2 launch litsim_sim litsim.launch.py``: the graph that it makes of its arguments."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from litsim_sim.launch.nodes import GraphOptions, nodes_of
from litsim_sim.scenario.run_info import RunPlan

FILE = Path(__file__).parents[3] / "src/litsim_sim/launch/litsim.launch.py"


def is_installed() -> bool:
    """Whether ROS 2's launch is here: a folder of that name on the path makes an empty package of it."""
    try:
        from launch_ros.actions import Node  # noqa: F401

        from launch import LaunchDescription  # noqa: F401
    except ImportError:
        return False
    return True


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("litsim_launch", FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Written(SimpleNamespace):
    """An action as the file has written it down: `what` it is, and its arguments by name."""


@pytest.fixture
def written_down(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The launch file over a stand-in of launch's classes that only notes what they were called with."""

    def noting(name: str) -> Callable[..., Written]:
        return lambda *given, **named: Written(what=name, given=given, **named)

    class Configuration:
        def __init__(self, name: str) -> None:
            self.name = name

        def perform(self, context: dict[str, str]) -> str:
            return context[self.name]

    modules = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "EmitEvent", "OpaqueFunction", "RegisterEventHandler"),
        "launch.event_handlers": ("OnProcessExit",),
        "launch.events": ("Shutdown",),
        "launch.substitutions": (),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for path, names in modules.items():
        module = ModuleType(path)
        for name in names:
            setattr(module, name, noting(name))
        monkeypatch.setitem(sys.modules, path, module)
    sys.modules["launch.substitutions"].LaunchConfiguration = Configuration  # type: ignore[attr-defined]
    return load()


def arguments(module: ModuleType, **values: str) -> dict[str, str]:
    defaults = {name: default for name, default, _, _ in module.ARGUMENTS}
    assert set(values) <= set(defaults)
    return defaults | values


def test_it_starts_the_nodes_of_the_launcher_with_the_same_parameters(written_down: ModuleType, tmp_path: Path) -> None:
    given = arguments(
        written_down, ego="perturbed", set="conflict.horizon=2 ego.kind=brake", out=str(tmp_path), seed="5"
    )
    nodes = [each for each in written_down.graph(given) if each.what == "Node"]
    settings = [("conflict", "horizon", 2), ("ego", "kind", "brake")]
    plan = RunPlan.load("demo", "perturbed", "litsim", seed=5, settings=settings)
    expected = nodes_of(plan, GraphOptions("demo", tmp_path, progress="none"))
    assert [(n.package, n.executable, n.parameters[0]) for n in nodes] == [
        (e.package, e.executable, dict(e.parameters)) for e in expected
    ]


def test_the_run_is_over_when_the_recorder_has_ended_well(written_down: ModuleType) -> None:
    actions = written_down.graph(arguments(written_down, policy="replay"))
    ends = {
        a.given[0].target_action.executable: a.given[0].on_exit for a in actions if a.what == "RegisterEventHandler"
    }
    well, badly = SimpleNamespace(returncode=0), SimpleNamespace(returncode=1)
    assert ends["bridge"](well, None) is None
    assert ends["recorder"](well, None).event.what == "Shutdown"
    for name in ("bridge", "recorder"):
        with pytest.raises(RuntimeError, match=f"node {name} ended with exit status 1"):
            ends[name](badly, None)


def test_every_argument_says_what_it_is_and_what_it_may_be(written_down: ModuleType) -> None:
    declared = [each for each in written_down.generate_launch_description().given[0] if "Argument" in each.what]
    assert {each.given[0] for each in declared} >= {"scenario", "ego", "policy", "out", "mode"}
    for each in declared:
        assert each.description
        assert each.choices is None or each.default_value in each.choices


@pytest.mark.skipif(not is_installed(), reason="ROS 2's launch and launch_ros are not installed: no wheels bring them")
def test_ros_2_launch_reads_it() -> None:
    from launch import LaunchContext, LaunchDescription

    described: Any = load().generate_launch_description()
    assert isinstance(described, LaunchDescription)
    context = LaunchContext()
    for entity in described.entities[:-1]:
        entity.visit(context)
    assert len(described.entities[-1].visit(context)) == 8  # two handlers, six nodes
