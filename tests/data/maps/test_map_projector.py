"""Frame map of an imported Lanelet2 map is that which Autoware finds by map_projector_info.yaml."""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from litsim_data.maps.map_projector import PROJECTOR_FILE, located
from litsim_sim.core.errors import InputError

METRES_PER_DEGREE = 110_949.0  # of a meridian at 35.7 degrees north


def placed(folder: Path, info: str, *places: tuple[float, float]) -> np.ndarray:
    """Positions (n, 2) [m] of nodes at latitudes and longitudes, beside a file with `info`."""
    (folder / PROJECTOR_FILE).write_text(info)
    nodes = [
        ET.Element("node", {"id": str(k), "lat": str(lat), "lon": str(lon)}) for k, (lat, lon) in enumerate(places)
    ]
    return np.array(located(nodes, folder / "map.osm"))


def test_mgrs_counts_from_the_corner_of_the_square(tmp_path: Path) -> None:
    found = placed(tmp_path, "projector_type: MGRS\nmgrs_grid: 54SUE\n", (35.6886, 139.6917))
    assert found[0] == pytest.approx([81_620.900, 50_199.082], abs=0.01)
    found = placed(tmp_path, "projector_type: MGRS\nmgrs_grid: 31NEA\n", (0.0001, 3.0))
    assert found[0] == pytest.approx([0.0, 0.0001 * 110_574.0 * 0.9996], abs=0.01)  # central meridian, equator


def test_transverse_mercator_has_its_meridian_through_the_origin(tmp_path: Path) -> None:
    info = "projector_type: TransverseMercator\nmap_origin: {latitude: 35.7, longitude: 139.65, altitude: 3.0}\n"
    found = placed(tmp_path, info, (35.7, 139.65), (35.71, 139.65), (35.7, 139.66), (35.7, 139.64))
    assert found[0] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert found[1] == pytest.approx([0.0, 0.9996 * 0.01 * METRES_PER_DEGREE], abs=0.1)  # straight north
    assert found[2] == pytest.approx([-found[3][0], found[3][1]], abs=1e-6)  # the same on both sides


def test_local_cartesian_utm_is_turned_by_the_convergence_of_its_zone(tmp_path: Path) -> None:
    info = "projector_type: LocalCartesianUTM\nmap_origin: {latitude: 35.7, longitude: 139.65, altitude: 0.0}\n"
    origin, north = placed(tmp_path, info, (35.7, 139.65), (35.71, 139.65))
    assert origin == pytest.approx([0.0, 0.0], abs=1e-6)
    convergence = np.arctan2(north[0], north[1])
    assert np.rad2deg(convergence) == pytest.approx((141.0 - 139.65) * np.sin(np.deg2rad(35.7)), abs=0.01)


def test_tags_stay_where_the_projector_is_local_or_nobody_says(tmp_path: Path) -> None:
    node = ET.Element("node", {"id": "1", "lat": "0", "lon": "0"})
    assert located([node], tmp_path / "map.osm") is None
    (tmp_path / PROJECTOR_FILE).write_text("projector_type: Local\n")
    assert located([node], tmp_path / "map.osm") is None


@pytest.mark.parametrize(
    ("info", "fault"),
    [
        ("projector_type: MGRS\n", r"map_projector_info.yaml: .*mgrs_grid"),
        ("projector_type: TransverseMercator\n", r"map_projector_info.yaml: .*map_origin"),
        ("projector_type: Mercator\n", r"map_projector_info.yaml: .*projector_type"),
        ("projector_type: MGRS\nmgrs_grid: 54SUE\n", r"map.osm: .*node 1 has no lat"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, info: str, fault: str) -> None:
    (tmp_path / PROJECTOR_FILE).write_text(info)
    with pytest.raises(InputError, match=fault):
        located([ET.Element("node", {"id": "1"})], tmp_path / "map.osm")
