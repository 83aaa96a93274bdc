"""SUMO traffic on a motorway section: who drives, and how SUMO moves them. Runs in a process of its own.

Drivers are IDM drivers that differ from each other. Beyond the observed stretch every lane has a bottleneck whose speed
rises and falls, so that slow waves travel upstream through dense traffic, as they do at NGSIM's site.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from litsim_sim.recording import STEP_S, Kind
from litsim_sim.scene import FloatArray

ROUTES = {
    "through": ("upstream", "weave", "downstream"),
    "entering": ("on_ramp", "weave", "downstream"),
    "leaving": ("upstream", "weave", "off_ramp"),
}
VEHICLE_CLASS = {Kind.CAR: "passenger", Kind.TRUCK: "truck", Kind.MOTORCYCLE: "motorcycle"}
BOTTLENECK_X = 590.0  # [m] vehicles beyond are held to the bottleneck's speed


@dataclass(frozen=True)
class TrafficConfig:
    """The traffic to generate; the defaults resemble NGSIM US-101, 07:50.

    Attributes:
        warm_up_s: simulated time before the observation [s].
        main_flow: vehicles that want to enter the section by the through lanes [1/h].
        on_ramp_flow: vehicles that want to enter by the on-ramp [1/h].
        leaving_share: share of the main flow that takes the off-ramp.
        truck_share, motorcycle_share: of all vehicles.
        bottleneck_speed: mean speed downstream of the observed stretch [m/s].
        bottleneck_swing: amplitude of its oscillation [m/s].
        bottleneck_period: of the oscillation [s]; every lane has a phase of its own.
        time_gap, time_gap_spread: mean and standard deviation of the drivers' desired time gaps [s].
    """

    warm_up_s: float = 180.0
    main_flow: float = 9000.0
    on_ramp_flow: float = 600.0
    leaving_share: float = 0.08
    truck_share: float = 0.03
    motorcycle_share: float = 0.01
    bottleneck_speed: float = 14.0
    bottleneck_swing: float = 5.0
    bottleneck_period: float = 50.0
    time_gap: float = 1.35
    time_gap_spread: float = 0.3


@dataclass(frozen=True)
class Observation:
    """What was seen of each vehicle, in the order of vehicles; n vehicles.

    Attributes:
        kind: (n,) :class:`Kind`.
        length, width: (n,) [m].
        first: (n,) step at which a vehicle was first seen.
        front: n arrays (k, 2), front centre at successive steps, frame map [m].
    """

    kind: np.ndarray
    length: FloatArray
    width: FloatArray
    first: np.ndarray
    front: list[FloatArray]


def observe(net: str, seed: int, seconds: float, config: TrafficConfig) -> Observation:
    """Simulate traffic on the net at path `net` and watch it for `seconds` after the warm-up.

    Takes this process's only libsumo; :func:`litsim_sim.datasets.synthetic.synthesize` calls it in another process.
    """
    import libsumo

    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, 6)
    seen: dict[str, tuple[int, list[tuple[float, float]]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        demand = Path(folder) / "demand.rou.xml"
        fleet = _write_demand(demand, config, seconds, rng)
        command = ["sumo", "--net-file", net, "--route-files", str(demand), "--seed", str(seed)]
        command += ["--step-length", str(STEP_S), "--lanechange.duration", "4", "--collision.action", "none"]
        command += ["--time-to-teleport", "-1", "--no-warnings", "true", "--no-step-log", "true"]
        libsumo.start(command)
        try:
            warm_up, steps = round(config.warm_up_s / STEP_S), round(seconds / STEP_S)
            held: set[str] = set()
            for step in range(-warm_up, steps):
                libsumo.simulationStep()
                swing = np.sin(2.0 * np.pi * step * STEP_S / config.bottleneck_period + phases)
                speeds = config.bottleneck_speed + config.bottleneck_swing * swing
                for name in libsumo.vehicle.getIDList():
                    x, y = libsumo.vehicle.getPosition(name)
                    if step >= 0:
                        seen.setdefault(name, (step, []))[1].append((x, y))
                    if x > BOTTLENECK_X:
                        libsumo.vehicle.setMaxSpeed(name, float(speeds[libsumo.vehicle.getLaneIndex(name)]))
                        held.add(name)
        finally:
            libsumo.close()
    names = sorted(seen, key=lambda name: (seen[name][0], int(name)))
    kind, length, width = (np.array([fleet[name][i] for name in names]) for i in range(3))
    return Observation(
        kind, length, width, np.array([seen[n][0] for n in names]), [np.array(seen[n][1]) for n in names]
    )


def _write_demand(
    path: Path, config: TrafficConfig, seconds: float, rng: np.random.Generator
) -> dict[str, tuple[int, float, float]]:
    """Write SUMO's route file; returns kind, length and width [m] of every vehicle by name."""
    root = ET.Element("routes")
    for name, edges in ROUTES.items():
        ET.SubElement(root, "route", {"id": name, "edges": " ".join(edges)})
    total = config.warm_up_s + seconds
    departures: list[tuple[float, str]] = []
    for flow, ramp in ((config.main_flow, False), (config.on_ramp_flow, True)):
        count = round(flow * total / 3600.0)
        for time in np.sort(rng.uniform(0.0, total, count)):
            leaves = not ramp and rng.random() < config.leaving_share
            departures.append((float(time), "entering" if ramp else "leaving" if leaves else "through"))
    fleet: dict[str, tuple[int, float, float]] = {}
    for number, (time, route) in enumerate(sorted(departures), start=1):
        kind, length, width = _vehicle(config, rng)
        name = str(number)
        fleet[name] = (int(kind), length, width)
        driver = {
            "id": f"type_{name}",
            "vClass": VEHICLE_CLASS[kind],
            "length": f"{length:.2f}",
            "width": f"{width:.2f}",
            "carFollowModel": "IDM",
            "tau": f"{max(0.8, rng.normal(config.time_gap, config.time_gap_spread)):.3f}",
            "minGap": f"{rng.uniform(1.8, 3.0):.3f}",
            "accel": f"{rng.uniform(1.2, 2.2) * (0.6 if kind == Kind.TRUCK else 1.0):.3f}",
            "decel": f"{rng.uniform(2.0, 3.0):.3f}",
            "emergencyDecel": "7",
            "maxSpeed": f"{np.clip(rng.normal(23.0, 3.0), 15.0, 30.0) * (0.8 if kind == Kind.TRUCK else 1.0):.3f}",
            "speedDev": "0",
            "lcSpeedGain": f"{rng.uniform(1.0, 4.0):.3f}",
            "lcKeepRight": "0",
            "lcOvertakeRight": "1",
            "lcAssertive": f"{rng.uniform(1.5, 3.0):.3f}",
        }
        ET.SubElement(root, "vType", driver)
        lane = {"through": "random", "entering": "0", "leaving": "0"}[route]
        vehicle = {"id": name, "type": driver["id"], "route": route, "depart": f"{time:.1f}"}
        ET.SubElement(root, "vehicle", {**vehicle, "departLane": lane, "departSpeed": "avg", "departPos": "base"})
    ET.ElementTree(root).write(path, encoding="UTF-8")
    return fleet


def _vehicle(config: TrafficConfig, rng: np.random.Generator) -> tuple[Kind, float, float]:
    """A vehicle's class, length and width [m]."""
    draw = rng.random()
    if draw < config.truck_share:
        return Kind.TRUCK, round(float(rng.uniform(8.0, 17.0)), 2), round(float(rng.uniform(2.3, 2.55)), 2)
    if draw < config.truck_share + config.motorcycle_share:
        return Kind.MOTORCYCLE, round(float(rng.uniform(2.1, 2.5)), 2), round(float(rng.uniform(0.7, 0.9)), 2)
    length = float(np.clip(rng.normal(4.75, 0.55), 3.4, 6.2))
    return Kind.CAR, round(length, 2), round(float(np.clip(0.95 + 0.2 * length + rng.normal(0.0, 0.1), 1.5, 2.3)), 2)
