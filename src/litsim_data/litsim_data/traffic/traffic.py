"""SUMO traffic on a site: demand, and how SUMO moves it. Runs in a process of its own.

On the motorway every lane has a bottleneck beyond the observed stretch whose speed rises and falls, so that slow waves
travel upstream through dense traffic, as they do at NGSIM's site.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.traffic.drivers import Fleet, Vehicle, draw_vehicle, vehicle_type
from litsim_data.traffic.motion import Smoothness
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.scenario.scenario import packaged


@dataclass(frozen=True)
class Route:
    """A route through a net.

    Attributes:
        edges: SUMO ids, in order.
        flow: demand of vehicles for this route [1/h].
        lane: SUMO's departLane.
    """

    edges: tuple[str, ...]
    flow: float
    lane: str = "best"


@dataclass(frozen=True)
class Bottleneck:
    """A bottleneck of a motorway.

    Attributes:
        x: position beyond which vehicles are limited to the bottleneck's speed [m].
        speed: mean speed [m/s].
        swing: amplitude of its oscillation [m/s].
        period: period of the oscillation [s]; every lane has its own phase.
    """

    x: float
    speed: float
    swing: float
    period: float

    def speeds(self, step: int, phases: FloatArray) -> FloatArray:
        """Returns the speed limit (lanes,) [m/s] of each lane at `step`."""
        swing = np.sin(2.0 * np.pi * step * STEP_S / self.period + phases)
        return np.maximum(self.speed + self.swing * swing, 1.0)


@dataclass(frozen=True)
class Site:
    """A net and its traffic.

    Attributes:
        name: name of recordings; the net is ``nets/NAME.net.xml``.
        fleet: composition of the traffic.
        routes: demand.
        window: (x min, y min, x max, y max) within which box centres are recorded [m].
        bottleneck: the bottleneck; None if signals hold the traffic up.
        warm_up_s: simulated time before the observation [s].
        smoothness: of paths, except in turns, and of drivers, whose offsets spread as it says.
        lane_of_edge: lane number of edges where it is not the place from the left: ramps continue the auxiliary lane.
    """

    name: str
    fleet: Fleet
    routes: tuple[Route, ...]
    window: tuple[float, float, float, float]
    bottleneck: Bottleneck | None
    warm_up_s: float
    smoothness: Smoothness
    lane_of_edge: Mapping[str, int] = field(default_factory=dict)

    @property
    def net(self) -> Path:
        """Path of the packaged net that the traffic drives on."""
        return packaged(f"nets/{self.name}.net.xml")


@dataclass(frozen=True)
class Observation:
    """Observations of n vehicles.

    Attributes:
        vehicles: the vehicles.
        first: (n,) step at which a vehicle was first seen.
        front: n arrays (k, 2), front centre at successive steps, frame map [m].
        speed: n arrays (k,), along the lane [m/s].
        lights: SUMO's state at each step, one letter per link, by traffic light; empty without signals.
    """

    vehicles: list[Vehicle]
    first: np.ndarray
    front: list[FloatArray]
    speed: list[FloatArray]
    lights: dict[str, list[str]]


def observe(site: Site, seed: int, seconds: float) -> Observation:
    """Simulates the traffic of `site`, and observes it for `seconds` after the warm-up.

    Takes this process's only libsumo; :mod:`litsim_data.traffic.synthetic` calls it in other processes.

    Args:
        site: net and demand.
        seed: seed of demand and SUMO.
        seconds: duration of the observation [s].
    """
    import libsumo

    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, 8)
    observed: dict[str, tuple[int, list[tuple[float, float, float]]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        demand = Path(folder) / "demand.rou.xml"
        fleet = _write_demand(demand, site, site.warm_up_s + seconds, rng)
        command = ["sumo", "--net-file", str(site.net), "--route-files", str(demand), "--seed", str(seed)]
        command += ["--step-length", str(STEP_S), "--lanechange.duration", "4", "--collision.action", "none"]
        command += ["--time-to-teleport", "-1", "--no-warnings", "true", "--no-step-log", "true"]
        libsumo.start(command)
        lights: dict[str, list[str]] = {light: [] for light in libsumo.trafficlight.getIDList()}
        try:
            for step in range(-round(site.warm_up_s / STEP_S), round(seconds / STEP_S)):
                libsumo.simulationStep()
                places = {name: libsumo.vehicle.getPosition(name) for name in libsumo.vehicle.getIDList()}
                if step >= 0:
                    for light, states in lights.items():
                        states.append(libsumo.trafficlight.getRedYellowGreenState(light))
                    for name, place in places.items():
                        observed.setdefault(name, (step, []))[1].append((*place, libsumo.vehicle.getSpeed(name)))
                if site.bottleneck is not None:
                    speeds = site.bottleneck.speeds(step, phases)
                    for name, (x, _) in places.items():
                        if x > site.bottleneck.x:
                            lane = libsumo.vehicle.getLaneIndex(name)
                            libsumo.vehicle.setMaxSpeed(name, float(speeds[lane]))
        finally:
            libsumo.close()
    names = sorted(observed, key=lambda name: (observed[name][0], int(name)))
    first = np.array([observed[name][0] for name in names])
    rows = [np.array(observed[name][1]) for name in names]
    vehicles, front, speed = [fleet[name] for name in names], [r[:, :2] for r in rows], [r[:, 2] for r in rows]
    return Observation(vehicles, first, front, speed, lights)


def _write_demand(path: Path, site: Site, total: float, rng: np.random.Generator) -> dict[str, Vehicle]:
    """Writes SUMO's route file for `total` seconds, and returns every vehicle by name."""
    root = ET.Element("routes")
    for number, route in enumerate(site.routes):
        ET.SubElement(root, "route", {"id": f"route_{number}", "edges": " ".join(route.edges)})
    fleet: dict[str, Vehicle] = {}
    departures = [
        (float(time), number)
        for number, route in enumerate(site.routes)
        for time in rng.uniform(0.0, total, rng.poisson(route.flow * total / 3600.0))
    ]
    for number, (time, route_number) in enumerate(sorted(departures), start=1):
        name = str(number)
        fleet[name] = vehicle = draw_vehicle(site.fleet, rng)
        driver = vehicle_type(vehicle, site.fleet, rng)
        ET.SubElement(root, "vType", {"id": f"type_{name}", **driver})
        trip = {"id": name, "type": f"type_{name}", "route": f"route_{route_number}", "depart": f"{time:.1f}"}
        lane = site.routes[route_number].lane
        ET.SubElement(root, "vehicle", {**trip, "departLane": lane, "departSpeed": "avg", "departPos": "base"})
    ET.ElementTree(root).write(path, encoding="UTF-8")
    return fleet
