"""The sites of generated traffic: a motorway like NGSIM's US-101, and a signalised street."""

from __future__ import annotations

from itertools import pairwise

from litsim_data.traffic.drivers import Fleet
from litsim_data.traffic.motion import Smoothness
from litsim_data.traffic.traffic import Bottleneck, Route, Site

MAIN_FLOW, RAMP_FLOW, LEAVING_SHARE = 9100.0, 350.0, 0.05  # [1/h], [1/h]; NGSIM US-101, 07:50
US101_LIKE = Site(
    name="us101_like",
    fleet=Fleet(
        truck_share=0.03,
        motorcycle_share=0.01,
        truck_length=(8.0, 17.0),
        free_speed=17.5,
        eagerness=1.0,
        drivers=("US-101",),
    ),
    routes=(
        Route(("upstream", "weave", "downstream"), MAIN_FLOW * (1.0 - LEAVING_SHARE), "random"),
        Route(("upstream", "weave", "off_ramp"), MAIN_FLOW * LEAVING_SHARE, "0"),
        Route(("on_ramp", "weave", "downstream"), RAMP_FLOW, "0"),
    ),
    window=(120.0, -40.0, 520.0, 10.0),
    bottleneck=Bottleneck(x=590.0, speed=14.0, swing=3.0, period=50.0),
    warm_up_s=180.0,
    smoothness=Smoothness(7.0, offset=0.25, wander=0.12, unsteadiness=0.4),
    lane_of_edge={"on_ramp": 6, "off_ramp": 6},
)

ENTRIES = {"W": 600.0, "E": 600.0, "AN": 200.0, "AS": 200.0, "BN": 200.0, "BS": 200.0}  # [1/h] by where they come from
THROUGH, LEFT, RIGHT = 0.66, 0.17, 0.17  # shares of turns at each junction


def _urban_routes() -> tuple[Route, ...]:
    """Returns every way through the two junctions with its flow; lanes of turns are SUMO's choice."""
    ring = {"A": ("W", "AN", "B", "AS"), "B": ("A", "BN", "E", "BS")}  # arms from west, clockwise
    routes: list[Route] = []

    def follow(nodes: tuple[str, ...], flow: float) -> None:
        node, came = nodes[-1], nodes[-2]
        if node not in ring:
            routes.append(Route(tuple(f"{start}{end}" for start, end in pairwise(nodes)), flow))
            return
        arms = ring[node]
        for turn, share in ((1, LEFT), (2, THROUGH), (3, RIGHT)):
            follow((*nodes, arms[(arms.index(came) + turn) % 4]), flow * share)

    for entry, flow in ENTRIES.items():
        junction = {"W": "A", "E": "B"}.get(entry) or entry[0]
        follow((entry, junction), flow)
    return tuple(routes)


URBAN_LIKE = Site(
    name="urban_like",
    fleet=Fleet(
        truck_share=0.03,
        motorcycle_share=0.02,
        truck_length=(6.5, 9.0),
        free_speed=13.0,
        eagerness=0.05,
        drivers=("US-101", "I-80"),
    ),
    routes=_urban_routes(),
    window=(-225.0, -125.0, 225.0, 125.0),
    bottleneck=None,
    warm_up_s=150.0,
    smoothness=Smoothness(6.0, offset=0.15, wander=0.08, unsteadiness=0.15),
)

SITES = {site.name: site for site in (US101_LIKE, URBAN_LIKE)}
