"""The page of a run in a real browser: it plays, jumps and obeys the keyboard, and asks for nothing from elsewhere."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.campaign.criteria import CriterionResult
from litsim_eval.report import run_report
from litsim_eval.report.content import moments
from litsim_eval.report.forecasts import Forecasts
from litsim_eval.report.plans import Plans
from litsim_eval.report.verdict import verdict_in, verdict_text
from litsim_sim.record.run import Run

Browser = Any
FIELDS = (
    "[litsim.time, litsim.playing, litsim.view.following, litsim.view.shows, litsim.view.camera.scale, litsim.speed]"
)
PIXELS = "document.getElementById('view').toDataURL()"


@pytest.fixture(scope="module")
def page(chromium: Browser, small_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    time = np.linspace(0.4, 5.0, 12)
    step = np.arange(61)
    mean = np.stack(np.broadcast_arrays(20.0 + 8.0 * time + 0.8 * step[:, None], -1.83), axis=-1)
    spread = np.tile(np.stack([0.2 + time, 0.1 + 0.3 * time, 0.2 + 0.0 * time], axis=-1), (61, 1, 1))
    forecasts = Forecasts(np.ones(61, np.int64), step, time, mean, spread)
    way = np.linspace(20.0, 60.0, 21)
    place = np.concatenate([np.stack([k + way, np.full(21, -1.83)], axis=-1) for k in range(0, 40, 2)])
    plans = Plans("/planning/trajectory", np.arange(0, 40, 2), 21 * np.arange(1, 21), place, np.arange(20) // 10)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_report, "read_forecasts", lambda run: forecasts)
        patch.setattr(run_report, "read_plans", lambda run: plans)
        html = run_report.render(small_run, compute_metrics(small_run))
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(html)
    return path


@pytest.fixture
def browser(chromium: Browser, page: Path) -> Iterator[Browser]:
    chromium.open(page)
    yield chromium
    assert chromium.problems == []
    assert chromium.requests == [page.resolve().as_uri()]


def state(browser: Browser) -> dict[str, Any]:
    names = ("time", "playing", "following", "shows", "scale", "speed")
    return dict(zip(names, browser.run(FIELDS), strict=True))


def test_playing_moves_the_agents(browser: Browser) -> None:
    before, picture = state(browser), browser.run(PIXELS)
    assert before["time"] == 10  # the end of the history
    where = "litsim.scene.pose(5, litsim.time).x"
    x = browser.run(where)
    browser.click(*browser.middle("#play"))
    browser.wait("litsim.time > 14")
    assert state(browser)["playing"]
    assert browser.run(where) > x + 2.0
    assert browser.run(PIXELS) != picture
    browser.click(*browser.middle("#play"))
    stopped = state(browser)
    assert not stopped["playing"]
    assert browser.run("document.getElementById('clock').textContent") == f"{stopped['time'] / 10:.1f} s"


def test_ticks_of_time_stay_apart_from_5_s_to_2_h(browser: Browser) -> None:
    """Labels are about 30 pixels wide."""
    for seconds in (1, 5, 28, 300, 1800, 7200):
        for pixels in (150, 400, 1200):
            apart = browser.run(f"litsim.charts[0].constructor.tickStep({seconds}, {pixels})")
            assert apart * pixels / seconds >= 45.0
            assert apart == 1 or seconds / apart >= 1.2
    labels = "[...litsim.charts[0].element.querySelectorAll('.tick.middle')].map((each) => each.textContent)"
    assert browser.run(labels)[:2] == ["0 s", "1"], "of 6 s"


def test_speed_and_the_end(browser: Browser) -> None:
    browser.run("litsim.setSpeed(4); litsim.play()")
    browser.wait("litsim.time === litsim.scene.last && !litsim.playing")
    browser.press(" ", 32, " ")  # from the end it starts again
    browser.wait("litsim.playing && litsim.time < 30")


def test_unpacked_motion_is_that_of_the_run(browser: Browser, small_run: Run) -> None:
    for step, row in ((0, 0), (33, 1), (60, 149)):
        table = small_run.tables[step]
        x, y, speed = browser.run(f"(({{x, y, speed}}) => [x, y, speed])(litsim.scene.pose({row}, {step}))")
        assert (x, y, speed) == pytest.approx((table.x[row], table.y[row], table.speed[row]), abs=0.006)


def test_the_ledger_jumps(browser: Browser) -> None:
    browser.click(*browser.middle("#ledger tr[data-step] td:nth-child(3)"))
    assert state(browser)["time"] == 20
    assert browser.run("litsim.scene.agents[litsim.view.selected].id") == 2
    assert "the policy" in browser.run("document.getElementById('state').textContent")
    assert browser.run("document.querySelector('#plots path.selected').dataset.agent") == "2"
    assert browser.run("document.querySelectorAll('tr.current').length") == 1
    box = browser.run("(({top, bottom}) => [top, bottom])(document.getElementById('view').getBoundingClientRect())")
    assert box[0] < 500 and box[1] > 100  # the view is on the screen


def test_plans_of_the_stack(browser: Browser) -> None:
    assert not browser.run("document.getElementById('plan').hidden")
    assert browser.run("document.getElementById('plan').title").endswith("on /planning/trajectory (T)")
    x, y, stop = browser.run("(({points, stop}) => [points[20].x, points[20].y, stop])(litsim.scene.planAt(11.5))")
    assert ([x, y], stop) == ([pytest.approx(70.0, abs=0.06), pytest.approx(-1.83, abs=0.06)], False)  # of step 10
    assert browser.run("litsim.scene.planAt(38).stop")
    assert browser.run("litsim.scene.planAt(55)") is None  # too old


def test_keyboard(browser: Browser) -> None:
    browser.press("ArrowRight", 39)
    browser.press("ArrowRight", 39)
    browser.press("ArrowLeft", 37)
    assert state(browser)["time"] == 11
    browser.press("ArrowRight", 39, modifiers=8)  # shift: a second
    assert state(browser)["time"] == 21
    before = state(browser)
    browser.press("+", 187, "+")
    assert state(browser)["scale"] > before["scale"]
    browser.press("-", 189, "-")
    assert state(browser)["scale"] == pytest.approx(before["scale"])
    for key, what in (("t", "plan"), ("g", "ghosts"), ("p", "forecasts"), ("c", "conflicts")):
        shown, picture = state(browser)["shows"][what], browser.run(PIXELS)
        browser.press(key, ord(key.upper()), key)
        assert state(browser)["shows"][what] is not shown
        assert browser.run(f"document.getElementById('{what}').getAttribute('aria-pressed')") == str(not shown).lower()
        assert browser.run(PIXELS) != picture
    browser.press("f", 70, "f")
    assert not state(browser)["following"]
    browser.press(" ", 32, " ")
    assert state(browser)["playing"]
    browser.press(" ", 32, " ")
    assert not state(browser)["playing"]
    browser.press("?", 191, "?", modifiers=8)
    assert browser.run("document.getElementById('keys').open")
    browser.press("Escape", 27)
    browser.wait("!document.getElementById('keys').open")


def test_focus_is_visible_and_buttons_keep_the_space_bar(browser: Browser) -> None:
    browser.run("document.getElementById('view').focus()")
    browser.press("Tab", 9)
    browser.press("ArrowUp", 38)  # on the time slider: faster, and the time stays
    assert state(browser)["speed"] == 2
    assert state(browser)["time"] == 10
    browser.run("document.getElementById('ghosts').focus()")
    browser.press("Tab", 9)
    focused = "document.activeElement"
    assert browser.run(f"{focused}.id") == "forecasts"
    assert browser.run(f"getComputedStyle({focused}).outlineStyle") == "solid"
    browser.press(" ", 32, " ")
    browser.wait("litsim.view.shows.forecasts")
    assert not state(browser)["playing"]


def test_pointer(browser: Browser) -> None:
    box = "document.getElementById('view').getBoundingClientRect()"
    at = f"(({{x, y}}) => [{box}.left + x, {box}.top + y])"
    x, y = browser.run(f"{at}(litsim.view.toScreen(litsim.scene.pose(2, litsim.time)))")
    browser.mouse("mouseMoved", x, y)
    browser.wait("!document.getElementById('tip').hidden")
    assert "Agent 3" in browser.run("document.getElementById('tip').textContent")
    browser.click(x, y)
    assert browser.run("litsim.scene.agents[litsim.view.selected].id") == 3
    browser.press("Escape", 27)
    assert browser.run("litsim.view.selected === null")
    camera = browser.run("litsim.view.camera.x")
    x, y = browser.middle("#view")
    browser.mouse("mousePressed", x, y + 90, button="left", clickCount=1)
    browser.mouse("mouseMoved", x - 70, y + 90, button="left", buttons=1)
    browser.mouse("mouseReleased", x - 70, y + 90, button="left", clickCount=1)
    assert not state(browser)["following"]
    assert browser.run("litsim.view.camera.x") == pytest.approx(camera + 70 / state(browser)["scale"], abs=0.2)
    scale = state(browser)["scale"]
    browser.mouse("mouseWheel", x, y, deltaX=0, deltaY=-300)
    browser.wait(f"litsim.view.camera.scale > {1.2 * scale}")


def test_plots_jump_and_slider_scrubs(browser: Browser) -> None:
    browser.click(*browser.middle("#plots svg"))
    assert state(browser)["time"] == pytest.approx(28, abs=1)  # a little before the middle, for the axis is on the left
    browser.run("((s) => { s.value = 42; s.dispatchEvent(new Event('input')); })(document.getElementById('scrub'))")
    assert state(browser)["time"] == 42


@pytest.mark.parametrize(("size", "dark"), [((1280, 720), True), ((390, 800), False)])
def test_layouts(chromium: Browser, page: Path, size: tuple[int, int], dark: bool) -> None:
    chromium.open(page, size=size, dark=dark)
    assert chromium.run("document.documentElement.scrollWidth") <= size[0]
    bottom = chromium.run("document.getElementById('play').getBoundingClientRect().bottom")
    assert bottom < size[1]  # the player is there without scrolling
    assert chromium.run("document.getElementById('view').clientHeight") >= 200
    assert chromium.problems == []


def test_on_paper_it_is_light_to_scale_and_without_controls(chromium: Browser, page: Path) -> None:
    chromium.open(page, dark=True)
    ground = "litsim.view.colours.ground"
    assert chromium.run(ground) == "#171a1d"
    features = [{"name": "prefers-color-scheme", "value": "dark"}]
    chromium.send("Emulation.setEmulatedMedia", media="print", features=features)
    chromium.wait(f"{ground} === '#eceeea'")
    style = "getComputedStyle(document.querySelector('{}')).{}"
    assert chromium.run(style.format(".controls", "display")) == "none"
    assert chromium.run(style.format("#view", "objectFit")) == "contain"
    assert chromium.run("document.querySelector('.chart').viewBox.baseVal.width") > 100
    chromium.send("Emulation.setEmulatedMedia", media="", features=features)
    chromium.wait(f"{ground} === '#171a1d'")


def test_names_that_look_like_html_are_text(chromium: Browser, small_run: Run, tmp_path: Path) -> None:
    name = "a\"b'c</script><script>document.title = 'taken over'</script><img src=x>{{ 7 * 7 }}"
    run = replace(small_run, info=replace(small_run.info, scenario=name, run_id=name, ego=name))
    path = tmp_path / "report.html"
    path.write_text(run_report.render(run, compute_metrics(run)))
    chromium.open(path)
    chromium.run("litsim.select(0)")  # the ego, whose state names its driver
    assert chromium.run("document.querySelector('#state dd').textContent") == name
    assert chromium.run("document.querySelector('h1').textContent") == name
    assert chromium.run("document.title").startswith(name)
    assert chromium.run("[document.images.length, document.scripts.length]") == [0, 3]
    assert chromium.problems == []
    assert chromium.requests == [path.resolve().as_uri()]


def test_places_far_from_the_origin_are_exact(
    chromium: Browser, small_run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    far = np.array([513_250.0, 5_429_125.0])  # of UTM, where numbers of single precision are half a metre apart
    mean, overlap = np.array([[[40.0 + k, -1.83] for k in range(12)]]) + far, np.array([50.0, -1.83]) + far
    forecasts = Forecasts(
        np.ones(1, np.int64), np.array([30]), 0.4 * np.arange(1, 13), mean, np.tile([0.5, 0.2, 0.0], (1, 12, 1))
    )
    monkeypatch.setattr(run_report, "read_forecasts", lambda run: forecasts)
    tables, log = (
        [replace(table, x=table.x + far[0], y=table.y + far[1]) for table in steps]
        for steps in (small_run.tables, small_run.log)
    )
    takeovers = {
        step: [replace(each, conflict_pose=(*overlap, 0.0)) for each in found]
        for step, found in small_run.takeovers.items()
    }
    run = replace(small_run, tables=tables, log=log, takeovers=takeovers, net_xml=b"")
    path = tmp_path / "report.html"
    path.write_text(run_report.render(run, compute_metrics(run)))
    chromium.open(path)
    chromium.run("litsim.seek(30); litsim.select(0)")
    origin = chromium.run("litsim.scene.origin")
    assert origin == [513_000.0, 5_429_000.0]
    here = f"{run.tables[30].x[0]:.1f}, {run.tables[30].y[0]:.1f} m"
    assert chromium.run("document.querySelector('#state dl').textContent").count(here) == 1
    for found, expected in (
        ("litsim.scene.pose(0, 30)", (run.tables[30].x[0], run.tables[30].y[0])),
        ("litsim.scene.ghost(1, 30)", (run.log[30].x[0], run.log[30].y[0])),
        ("litsim.scene.forecastsAt(30)[0].points[11]", mean[0, 11]),
        ("(([x, y]) => ({x, y}))(litsim.scene.takeoversAt(30)[0].pose)", overlap),
    ):
        place = chromium.run(f"(({{x, y}}) => [x, y])({found})")
        assert np.add(place, origin) == pytest.approx(np.array(expected), abs=0.03, rel=0)
    assert chromium.problems == []


def test_the_address_names_a_step(browser: Browser) -> None:
    browser.run("location.hash = 't=2.9'")  # 2.9 / 0.1 is less than 29
    browser.wait("litsim.time === 29")
    assert browser.run("document.getElementById('clock').title") == "step 29"


def test_a_verdict_is_shown_with_marks_where_a_criterion_is_missed(
    chromium: Browser, small_run: Run, tmp_path: Path
) -> None:
    metrics = compute_metrics(small_run)
    missed, spans = next(iter(moments(small_run, metrics).items()))
    criteria = [
        CriterionResult("few", "takeovers", 1, "at most 3", passed=True, reason=""),
        CriterionResult("calm", missed, 0.5, "at least 0.9", passed=False, reason="it went <too> fast"),
    ]
    said = verdict_text(
        "failed", "it went <too> fast", criteria, campaign="../experiment.html#run=a", rerun="again 'a'"
    )
    path = tmp_path / "report.html"
    path.write_text(run_report.render(small_run, metrics, said))
    assert verdict_in(path) == said
    chromium.open(path)
    assert chromium.problems == []
    assert chromium.run("[...document.querySelectorAll('#badges span')].map((each) => each.textContent)")[0] == "failed"
    assert chromium.run("document.querySelectorAll('#badges .good').length") == 0
    assert "it went <too> fast" in chromium.run("document.getElementById('judged').textContent")
    assert chromium.run("document.querySelector('#judged a').getAttribute('href')") == "../experiment.html#run=a"
    assert chromium.run("document.querySelectorAll('#events .missed').length") == len(spans)
    rows = "[...document.querySelectorAll('#criteria tbody tr')].map((row) => row.cells[0].textContent)"
    assert chromium.run(rows) == ["calm", "few"]
    chromium.run("document.querySelector('#criteria tbody tr').click()")
    assert chromium.run("litsim.time") == spans[0][0] - small_run.tables[0].step
    titles = chromium.run("[...document.querySelectorAll('figcaption b')].map((each) => each.textContent)")
    assert {"Acceleration", "Jerk", "Yaw rate", "Headway"} <= set(titles)
    assert chromium.run("document.querySelectorAll('.chart .bound').length") > 0
