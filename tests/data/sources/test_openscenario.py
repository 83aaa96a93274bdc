"""OpenSCENARIO files of others: catalogs, parameters, relative times, and what is no trajectory in time."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import made_sources
from litsim_data.cli import main
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario

BOX = (
    '<BoundingBox><Center x="{x}" y="0" z="0.8"/><Dimensions length="{length}" width="2.0" height="1.6"/></BoundingBox>'
)
VAN = f'<Vehicle name="box" vehicleCategory="van">{BOX.format(x=2.0, length=6.0)}</Vehicle>'
CAR = '<Vehicle name="car" vehicleCategory="car">' + BOX.format(x="$middle", length=5.0) + "</Vehicle>"
FOLLOW = (
    "<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name='t' closed='false'><Shape>"
    "<Polyline>{vertices}</Polyline></Shape></Trajectory></TrajectoryRef><TimeReference>{timing}</TimeReference>"
    "</FollowTrajectoryAction></RoutingAction></PrivateAction>"
)
TIMING = '<Timing domainAbsoluteRelative="{domain}" scale="1.0" offset="{offset}"/>'
AT = (
    "<StartTrigger><ConditionGroup><Condition name='at' delay='0' conditionEdge='none'><ByValueCondition>"
    "<SimulationTimeCondition value='{time}' rule='greaterThan'/></ByValueCondition></Condition></ConditionGroup>"
    "</StartTrigger>"
)


def vertices(x: np.ndarray, y: float, heading: str = "") -> str:
    """Vertices every 0.1 s."""
    places = (f'<WorldPosition x="{value:.3f}" y="{y}" {heading}/>' for value in x)
    return "".join(
        f'<Vertex time="{0.1 * k:.1f}"><Position>{place}</Position></Vertex>' for k, place in enumerate(places)
    )


def write(folder: Path, road: str = "made.xodr", timing: str = TIMING.format(domain="relative", offset=0)) -> Path:
    """Three seconds: a car drives east, a van follows from a catalog; a third vehicle waits, and a tram is none."""
    (folder / "catalogs").mkdir(parents=True)
    (folder / "catalogs" / "vans.xosc").write_text(f'<OpenSCENARIO><Catalog name="vans">{VAN}</Catalog></OpenSCENARIO>')
    (folder / "made.xodr").write_text(made_sources.opendrive())
    x = np.arange(0.0, 30.1)
    late = FOLLOW.format(vertices=vertices(x[:21] - 110.0, -1.75), timing=timing)
    first = FOLLOW.format(
        vertices=vertices(x - 80.0, -1.75, 'h="0"'), timing=TIMING.format(domain="absolute", offset=0)
    )
    path = folder / "made.xosc"
    path.write_text(
        '<?xml version="1.0"?><OpenSCENARIO><FileHeader revMajor="1" revMinor="0" date="2026-11-01T00:00:00"'
        ' author="" description=""/><ParameterDeclarations><ParameterDeclaration name="middle" parameterType="double"'
        ' value="1.5"/></ParameterDeclarations><CatalogLocations><VehicleCatalog><Directory path="catalogs"/>'
        f'</VehicleCatalog></CatalogLocations><RoadNetwork><LogicFile filepath="{road}"/></RoadNetwork><Entities>'
        f'<ScenarioObject name="ego">{CAR}</ScenarioObject><ScenarioObject name="van"><CatalogReference'
        f' catalogName="vans" entryName="box"/></ScenarioObject><ScenarioObject name="waits">{VAN}</ScenarioObject>'
        '<ScenarioObject name="tram"><Vehicle name="tram" vehicleCategory="tram"/></ScenarioObject></Entities>'
        f'<Storyboard><Init><Actions><Private entityRef="ego">{first}</Private></Actions></Init><Story name="s"><Act'
        ' name="a"><ManeuverGroup name="g" maximumExecutionCount="1"><Actors selectTriggeringEntities="false">'
        '<EntityRef entityRef="van"/></Actors><Maneuver name="m"><Event name="e" priority="overwrite"><Action name="f">'
        f"{late}</Action>{AT.format(time=1.0)}</Event></Maneuver></ManeuverGroup></Act></Story></Storyboard></OpenSCENARIO>"
    )
    return path


def test_without_any_trajectory_in_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "in")
    path.write_text(path.read_text().replace("Timing", "None"))
    with pytest.raises(SystemExit, match="2"):
        main(["convert", str(path), str(tmp_path / "out.parquet")])
    assert "no FollowTrajectoryAction with Timing" in capsys.readouterr().err


def test_what_is_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "in")
    main(["import", str(tmp_path / "in"), str(tmp_path / "out")])
    text = capsys.readouterr().out
    assert "2 entities without a trajectory in time are left out" in text
    recording = Recording.read(tmp_path / "out" / "made.parquet")
    ids, table = recording.header.notes["ids"], recording.table
    ego, van = (table[table["vehicle_id"] == ids[name]] for name in ("ego", "van"))  # type: ignore[index]
    np.testing.assert_allclose(ego["x"], np.arange(0.0, 30.1) - 80.0 + 1.5, atol=1e-6)
    assert set(ego["length"]) == {5.0} and set(van["length"]) == {6.0} and set(table["kind"]) == {Kind.CAR}
    assert van["frame"].tolist() == list(range(10, 31)), "its times count from the start of its event"
    np.testing.assert_allclose(van["x"], np.arange(0.0, 20.1) - 110.0 + 2.0, atol=1e-6)
    np.testing.assert_allclose(van["yaw"], 0.0, atol=1e-9)
    (scenario,) = (tmp_path / "out" / "scenarios").glob("*_train_*.yaml")
    assert Scenario.load(scenario).ego_id == ids["ego"]  # type: ignore[index]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("made.xodr", "gone.xodr"), r"RoadNetwork names .*gone\.xodr, which is no file: name the OpenDRIVE map by"),
        (
            ('entryName="box"', 'entryName="bus"'),
            r"entity van: \('vans', 'bus'\) is not in the file, nor in its CatalogLocations",
        ),
        (
            ('value="1.5"', 'value="${1+1}"'),
            "trajectory of ego: attribute x of element Center is '${1+1}', expected a number",
        ),
        (('x="-80.000"', 'x="east"'), "trajectory of ego: attribute x of element WorldPosition is 'east', expected a"),
        (("</OpenSCENARIO>", ""), "not a readable OpenSCENARIO file"),
    ],
)
def test_what_cannot_be_used(
    change: tuple[str, str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "in")
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(SystemExit, match="2"):
        main(["import", str(path), str(tmp_path / "out")])
    assert re.search(message.replace("${1+1}", re.escape("${1+1}")), capsys.readouterr().err)


@pytest.mark.parametrize("timing", ["<None/>", TIMING.format(domain="relative", offset="0")])
def test_trajectories_without_known_times_are_counted(timing: str, tmp_path: Path) -> None:
    path = write(tmp_path / "in", timing=timing)
    if "Timing" in timing:
        path.write_text(path.read_text().replace("SimulationTimeCondition", "ParameterCondition"))
    assert set(load_recording(path).header.notes["ids"]) == {"ego"}  # type: ignore[call-overload]
