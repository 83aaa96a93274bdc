"""The page of a run without a browser: structure, size, and what it must never hold."""

import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
import yaml

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.report import run_report
from litsim_eval.report.content import pack_run, signals
from litsim_eval.report.forecasts import Forecasts
from litsim_eval.report.pages import asset
from litsim_eval.report.run_report import render
from litsim_eval.report.tracks import tracks_of
from litsim_sim.core.errors import InputError
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.record.run import Run
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals
from packed import of_page, unpack

Make = Callable[..., Any]
VOID = {"meta", "link", "input", "br"}


def made_forecasts(steps: int, agents: int, points: int = 13) -> Forecasts:
    """Forecasts of agents that drive straight on, with noise that a learned predictor would have."""
    random = np.random.default_rng(0)
    agent, step = (v.ravel() for v in np.meshgrid(np.arange(1, agents + 1), np.arange(steps), indexing="ij"))
    time = np.linspace(0.2, 5.0, points)
    ahead = np.stack(np.broadcast_arrays(8.0 * time, 0.0), axis=-1) + np.stack([0.8 * step, agent], axis=1)[:, None]
    spread = np.stack([0.2 + 1.3 * time, 0.1 + 0.25 * time, 0.0 * time], axis=-1)
    noise = random.normal(0.0, 0.1, (len(agent), points, 3))
    return Forecasts(agent, step, time, ahead + noise[..., :2].cumsum(axis=1), spread + np.abs(noise))


@pytest.fixture
def html(small_run: Run, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(run_report, "read_forecasts", lambda run: made_forecasts(61, 10))
    return render(small_run, compute_metrics(small_run))


class Structure(HTMLParser):
    """Whether tags close in order; ids, and what is loaded from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID and not (self.open and self.open[-1] == "svg" and tag == "path"):
            self.open.append(tag)
        self.ids += [value or "" for name, value in attrs if name == "id"]
        self.loads += [
            value or "" for name, value in attrs if name in ("src", "href") and not (value or "").startswith("#")
        ]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Closes itself."""

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag


def test_structure(html: str) -> None:
    page = Structure()
    page.feed(html)
    assert not page.open
    assert len(page.ids) == len(set(page.ids))
    assert {"view", "plots", "ledger", "scrub", "data"} <= set(page.ids)
    assert page.loads == ["data:,"]  # the empty icon
    before_data = html[: html.index('<script id="data"')]
    assert not re.search(r"\$[a-z_]+", before_data)  # every field is filled


def test_data_of_the_page(html: str) -> None:
    content, arrays = of_page(html)
    assert content["run"]["ego"] == 1
    assert arrays["x"].shape == arrays["mode"].shape == (150, 61)
    assert arrays["forecast_x"].shape == (610, 13)
    assert [len(each) for each in content["takeovers"]] == [int(20 <= k <= 45) for k in range(61)]
    assert content["road"]["lanes"] and content["road"]["lines"]
    assert sum(bool(path) for path in content["paths"]) == 1  # the same path at every step is kept once


def test_a_run_that_is_not_valid_is_not_praised(small_run: Run) -> None:
    praise, metrics = '<span class="badge good">no new contacts</span>', compute_metrics(small_run) | {"reactive": True}
    assert praise in render(small_run, metrics | {"valid": True})
    assert praise not in render(small_run, metrics | {"valid": False})


def test_an_ego_that_is_too_slow_is_told(small_run: Run) -> None:
    metrics = compute_metrics(small_run)
    metrics["timing"] = metrics["timing"] | {"answer_ms": {"median": 40.0, "p99": 250.0, "max": 300.0}}
    assert "too slow for 10 Hz" in render(small_run, metrics)


def test_changes_of_the_scenario_are_told(small_run: Run) -> None:
    brake = {"kind": "brake", "agent": 2, "begin_s": 4.0, "duration_s": 1.5, "deceleration": 2.0}
    for change, told in ((brake, True), ({"kind": "of a later version"}, False)):
        changed = replace(small_run, scenario_yaml=yaml.safe_dump(dict(small_run.scenario) | {"changes": [change]}))
        page = render(changed, compute_metrics(small_run))
        assert ("2 brakes at 2.00 m/s² for 1.5 s from 4.0 s on" in page) == told


def test_size_of_a_long_dense_run(small_run: Run) -> None:
    steady = [replace(small_run.tables[k % 61], step=k) for k in range(281)]
    long_run, metrics = replace(small_run, tables=steady, log=steady), compute_metrics(small_run)
    assert len(pack_run(long_run, metrics, made_forecasts(281, 20), 1)) < 1.0e6  # agents near the ego
    assert len(pack_run(long_run, metrics, made_forecasts(281, 150), 1)) < run_report.DATA_MAX < 9.0e6  # everybody


def test_forecasts_are_thinned_to_fit(small_run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_report, "read_forecasts", lambda run: made_forecasts(61, 100))
    monkeypatch.setattr(run_report, "DATA_MAX", 200_000)
    html = render(small_run, compute_metrics(small_run))
    assert "Forecasts are shown every" in html
    monkeypatch.setattr(run_report, "DATA_MAX", 10_000)
    with pytest.raises(InputError, match="too long for one page"):
        render(small_run, compute_metrics(small_run))


@pytest.mark.parametrize("lacking", ["net", "log", "takeovers", "some steps"])
def test_less_is_shown_of_a_run_that_lacks_something(lacking: str, small_run: Run) -> None:
    changes: dict[str, dict[str, Any]] = {
        "net": {"net_xml": b""},
        "log": {"log": []},
        "takeovers": {"takeovers": {}},
        "some steps": {
            "tables": small_run.tables[:7] + small_run.tables[9:],
            "log": small_run.log[:7] + small_run.log[9:],
        },
    }
    run = replace(small_run, **changes[lacking])
    metrics = compute_metrics(run)
    content, arrays = unpack(pack_run(run, metrics, made_forecasts(0, 0), 1))
    assert arrays["x"].shape == (150, 61)
    assert bool(content["road"]["lanes"]) == (lacking != "net")
    assert content["ghosts"] == ([] if lacking == "log" else [1, 2])


PAIRS = {
    "report.css": [
        *(("ink", "page"), ("ink", "card"), ("ink", "button"), ("ink", "ground"), ("muted", "page"), ("muted", "card")),
        *(("accent", "card"), ("accent", "button"), ("good", "good-back"), ("bad", "bad-back")),
    ],
    "campaign.css": [("error", "error-back"), *(("bar-ink", f"bar-{each}") for each in ("passed", "failed", "error"))],
}


@pytest.mark.parametrize("style", PAIRS)
def test_contrast(style: str) -> None:
    light, dark = themes(style)
    for colours in (light, light | dark):
        ratios = {pair: contrast(*(colours[name] for name in pair)) for pair in PAIRS[style]}
        assert min(ratios.values()) >= 4.5, ratios


def themes(style: str) -> list[dict[str, str]]:
    """Colours by name, of the light scheme and of the dark one."""
    schemes = re.findall(r":root \{(.*?)\}", asset(style), re.DOTALL)
    assert len(schemes) == 2
    return [dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", scheme)) for scheme in schemes]


def contrast(a: str, b: str) -> float:
    """Contrast ratio of WCAG 2 between two colours."""

    def luminance(colour: str) -> float:
        channels = np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted((luminance(a), luminance(b)))
    return (high + 0.05) / (low + 0.05)


def test_stop_lines_show_what_their_signals_do(small_run: Run) -> None:
    links = tuple(link for link in read_links(packaged("nets/urban_like.net.xml")) if link.from_lane == "WA_0")
    states = np.full((2, 61), int(SignalState.GREEN), np.uint8)
    states[0, 20:40], states[0, 40:], states[1, :] = SignalState.AMBER, SignalState.RED, SignalState.UNAVAILABLE
    run = replace(small_run, signals=Signals(("straight", "right"), links, np.array([1, 0]), states))
    assert [link.name for link in links] == ["WA_0 -> AAS_0", "WA_0 -> AB_0"]
    right, straight = signals(run, tracks_of(run), np.zeros(2))
    assert straight["shown"] == [[0, "green"], [20, "amber"], [40, "red"]]
    assert right["shown"] == [[0, ""]]
    # eastwards, so that the left half of the lane's end is the one above
    assert (straight["line"][0], right["line"][0]) == (-114.6, -114.6)
    assert straight["line"][1] > straight["line"][3] > -8.25 > right["line"][1] > right["line"][3]
    assert signals(small_run, tracks_of(small_run), np.zeros(2)) == []
