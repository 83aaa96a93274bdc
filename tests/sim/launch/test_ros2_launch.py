"""``ros2 launch litsim_sim litsim.launch.py``: the graph that it makes of its arguments."""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.launch.domain import HOLDER
from litsim_sim.launch.nodes import nodes_of
from litsim_sim.scenario.run_info import RunPlan

FILE = Path(__file__).parents[3] / "src/litsim_sim/launch/litsim.launch.py"


USUAL = {"mode": "lockstep", "on_missing": "stop", "on_invalid": "stop", "ego_interface": "auto"}


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
def written_down(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
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
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # for locks of domains
    monkeypatch.setenv(HOLDER, "nobody")
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
    expected = nodes_of(plan, "demo", tmp_path, **USUAL, progress="none")
    assert [(n.package, n.executable, n.parameters[0]) for n in nodes] == [
        (e.package, e.executable, dict(e.parameters)) for e in expected
    ]


def ends_of(actions: list[Any]) -> dict[str, Callable[[Any, None], Any]]:
    """What is done when a node ends, by the name of its executable."""
    handlers = [a.given[0] for a in actions if a.what == "RegisterEventHandler"]
    return {each.target_action.executable: each.on_exit for each in handlers}


WELL = SimpleNamespace(returncode=0)


@pytest.mark.parametrize(("first", "last"), [("recorder", "bridge"), ("bridge", "recorder")])
def test_the_run_is_over_when_bridge_and_recorder_have_ended_well(
    written_down: ModuleType, tmp_path: Path, first: str, last: str
) -> None:
    ends = ends_of(written_down.graph(arguments(written_down, policy="replay", out=str(tmp_path))))
    assert ends[first](WELL, None) is None
    assert ends[last](WELL, None).event.what == "Shutdown"


@pytest.mark.parametrize("name", ["bridge", "recorder"])
@pytest.mark.parametrize("status", [2, -9])
def test_any_other_end_of_either_is_that_of_a_launch_that_failed(
    written_down: ModuleType, tmp_path: Path, name: str, status: int
) -> None:
    ends = ends_of(written_down.graph(arguments(written_down, policy="replay", out=str(tmp_path))))
    (other,) = set(ends) - {name}
    assert ends[other](WELL, None) is None
    with pytest.raises(RuntimeError, match=f"node {name} ended with exit status {status}"):
        ends[name](SimpleNamespace(returncode=status), None)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"seed": "abc"}, "seed:=abc: expected a whole number"),
        ({"ego_id": "1.5"}, "ego_id:=1.5: expected a whole number"),
        ({"set": "conflict.horizon"}, "set:=conflict.horizon: 'conflict.horizon': expected STAGE.NAME=VALUE"),
        ({"set": "ego.kind='brake"}, "set:=ego.kind='brake: No closing quotation"),
        ({"set": "conflict.horizon=-1"}, "conflict: parameter horizon is -1, expected a number of at least"),
        ({"scenario": "none.yaml"}, "none.yaml"),
    ],
)
def test_what_is_wrong_is_said_in_a_line_before_anything_starts(
    written_down: ModuleType, tmp_path: Path, values: dict[str, str], said: str
) -> None:
    out = tmp_path / "out"
    with pytest.raises(InputError) as error:
        written_down.graph(arguments(written_down, out=str(out), **values))
    assert said in str(error.value) and "\n" not in str(error.value)
    assert not out.exists()


def test_a_recording_that_is_there_stays_unless_it_is_to_go(written_down: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "run_0.mcap").touch()
    with pytest.raises(InputError, match="holds a recording already"):
        written_down.graph(arguments(written_down, out=str(tmp_path)))
    assert written_down.graph(arguments(written_down, out=str(tmp_path), overwrite="true"))


def test_values_of_parameters_may_hold_spaces(written_down: ModuleType) -> None:
    given = written_down.settings("conflict.horizon=2 'ego.time=[0.0, 1.5]' policy.safety.horizon=3")
    assert given == [("conflict", "horizon", 2), ("ego", "time", (0.0, 1.5)), ("policy", "safety.horizon", 3)]


def test_every_argument_says_what_it_is_and_what_it_may_be(written_down: ModuleType) -> None:
    declared = [each for each in written_down.generate_launch_description().given[0] if "Argument" in each.what]
    assert {each.given[0] for each in declared} >= {"scenario", "ego", "policy", "out", "mode"}
    for each in declared:
        assert each.description
        assert each.choices is None or each.default_value in each.choices
        assert all(type(choice) is str for choice in each.choices or ())  # not a member of an enum: they are shown


@pytest.mark.skipif(not is_installed(), reason="ROS 2's launch and launch_ros are not installed: no wheels bring them")
def test_ros_2_launch_reads_it(tmp_path: Path) -> None:
    from launch import LaunchContext, LaunchDescription

    described: Any = load().generate_launch_description()
    assert isinstance(described, LaunchDescription)
    context = LaunchContext()
    for entity in described.entities[:-1]:
        entity.visit(context)
    context.launch_configurations["out"] = str(tmp_path)
    assert len(described.entities[-1].visit(context)) == 8  # two handlers, six nodes
