"""The page of a campaign in a real browser: it sorts, filters, opens runs, and stays quick to draw with thousands."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from campaigns import VERSIONS, cases, page_of, suite
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.report.thumbnails import read_thumbnail, write_thumbnail
from litsim_sim.record.run import Run

Browser = Any
Write = Callable[..., Path]
HOSTILE = "a\"b'c</script><script>document.title = 'taken over'</script><img src=x>{{ 7 * 7 }}"
NAMES = "[...document.querySelectorAll('#runs tr[data-id] button.run')].map((each) => each.textContent)"
SHOWN = "document.getElementById('shown').textContent"


@pytest.fixture(scope="module")
def folder(campaign: Write, small_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of twelve runs; the first has a picture and a report, the one that is an error a log."""
    path = campaign(tmp_path_factory.mktemp("campaign"))
    first = path / "runs/repl000000000000"
    write_thumbnail(small_run, compute_metrics(small_run), first)
    (first / "run").mkdir()
    (first / "run/report.html").write_text("")
    (path / "runs/lits000000000004/ads.log").write_text("")
    return path


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    return page_of(folder)


@pytest.fixture
def browser(chromium: Browser, page: Path) -> Iterator[Browser]:
    chromium.open(page)
    yield chromium
    assert chromium.problems == []
    assert {request.split("#")[0] for request in chromium.requests} == {page.resolve().as_uri()}


def heading(browser: Browser, column: str) -> None:
    """Click the heading of a column."""
    browser.run(f"document.querySelector('#runs th[data-column=\"{column}\"] button').click()")


def column(browser: Browser, name: str) -> list[str]:
    """Texts of a column of the table, as far as its rows are drawn."""
    at = f"[...document.querySelectorAll('#runs th')].findIndex((each) => each.dataset.column === {json.dumps(name)})"
    return browser.run(
        f"[...document.querySelectorAll('#runs tr[data-id]')].map((row) => row.cells[{at}].innerText.trim())"
    )


def choose(browser: Browser, control: str, value: str) -> None:
    event = "input" if control == "text" else "change"
    browser.run(
        f"((box) => {{ box.value = {json.dumps(value)}; box.dispatchEvent(new Event('{event}')); }})"
        f"(document.getElementById('{control}'))"
    )


def test_the_worst_runs_stand_first(browser: Browser) -> None:
    assert column(browser, "verdict") == ["error"] + 5 * ["failed"] + 6 * ["passed"]
    assert browser.run("document.querySelector('#runs th[aria-sort]').dataset.column") == "verdict"


def test_a_heading_sorts_and_sorts_back(browser: Browser) -> None:
    heading(browser, "takeovers")
    up = column(browser, "takeovers")
    assert up == [*(6 * ["0"]), "0", "1", "2", "3", "5", "–"]
    heading(browser, "takeovers")
    assert column(browser, "takeovers") == [
        "5",
        "3",
        "2",
        "1",
        *(7 * ["0"]),
        "–",
    ]  # nothing to sort by: last either way
    assert browser.run("document.querySelector('#runs th[aria-sort]').getAttribute('aria-sort')") == "descending"
    heading(browser, "name")
    names = browser.run(NAMES)
    assert names == sorted(names)


def test_filters_narrow_the_table_together(browser: Browser) -> None:
    choose(browser, "verdict", "failed")
    assert browser.run(SHOWN) == "5 of 12 runs: 5 failed"
    choose(browser, "variant", "idm, replay")
    assert len(browser.run(NAMES)) == 3
    choose(browser, "criterion", "no contact at fault")
    assert browser.run(NAMES) == ["scene_0/7/idm/replay", "scene_3/7/idm/replay"]
    choose(browser, "tag", "odd")
    assert browser.run(NAMES) == ["scene_3/7/idm/replay"]
    browser.click(*browser.middle("#chips button"))  # the first chip drops its filter: the verdict
    assert "verdict" not in browser.run("document.getElementById('chips').textContent")
    browser.click(*browser.middle("#clear"))
    assert browser.run(SHOWN) == "12 of 12 runs: 1 error, 5 failed, 6 passed"
    assert browser.run("document.getElementById('variant').value") == ""


def test_words_are_searched_in_all_that_a_run_says(browser: Browser) -> None:
    browser.run("document.getElementById('runs').focus()")
    browser.press("/", 191, "/")
    assert browser.run("document.activeElement.id") == "text"
    browser.send("Input.insertText", text="no WEIGHTS")
    assert browser.run(NAMES) == ["scene_4/7/idm/litsim"]
    choose(browser, "text", "even litsim collision")
    assert browser.run(NAMES) == ["scene_0/7/idm/litsim"]
    choose(browser, "text", "nothing of the kind")
    assert browser.run(NAMES) == [] and "No run passes" in browser.run("document.getElementById('runs').innerText")


def test_where_no_run_is_over_that_is_said_and_not_that_filters_are_to_blame(chromium: Browser, tmp_path: Path) -> None:
    CampaignFolder(tmp_path).begin(suite(), cases(), VERSIONS)
    chromium.open(page_of(tmp_path))
    said = chromium.run("document.getElementById('runs').innerText")
    assert "No run is over yet." in said and "filters" not in said
    assert chromium.problems == []


def test_a_range_of_a_measure(browser: Browser) -> None:
    choose(browser, "measure", "safety.min_ttc_s")
    choose(browser, "low", "0.5")
    choose(browser, "high", "0.9")
    assert sorted(browser.run(NAMES)) == ["scene_3/7/idm/litsim", "scene_3/7/idm/replay", "scene_4/7/idm/replay"]
    assert "ego: shortest TTC [s]: 0.5 … 0.9" in browser.run("document.getElementById('chips').textContent")
    choose(browser, "low", "")
    choose(browser, "high", "")
    assert browser.run(SHOWN).startswith("12 of 12")


def test_a_stretch_of_a_distribution_filters(browser: Browser) -> None:
    figure = '#distributions figure[data-path="safety.min_ttc_s"] svg'
    browser.middle(figure)
    box = f"document.querySelector('{figure}').getBoundingClientRect()"
    left, right, y = browser.run(f"(({{left, right, top}}) => [left, right, top + 10])({box})")
    browser.mouse("mousePressed", right - 2, y, button="left", clickCount=1)
    browser.mouse("mouseReleased", left + 0.7 * (right - left), y, button="left", clickCount=1)
    assert {name.split("/")[0] for name in browser.run(NAMES)} == {"scene_4", "scene_5"}
    assert browser.run("document.querySelectorAll('#distributions .range').length") > 0


def test_what_is_far_out_shows_in_distributions(chromium: Browser, campaign: Write, tmp_path: Path) -> None:
    """Of 240 runs, a single one has more false alarms than the others, and a single one a larger TTC."""
    folder = campaign(tmp_path, scenes=120)
    odd = folder / "runs/repl000000000007/result.json"
    result = json.loads(odd.read_text())
    result["metrics"] |= {"false_alarms": result["metrics"]["false_alarms"] + 3}
    result["metrics"]["safety"] |= {"min_ttc_s": 1000.0}
    odd.write_text(json.dumps(result))
    chromium.open(page_of(folder))
    ends = (
        "[...document.querySelectorAll('#distributions figure[data-path=\"{}\"] .axis span')].map((e) => e.textContent)"
    )
    low, high = map(int, chromium.run(ends.format("false_alarms")))
    assert high == low + 3
    assert chromium.run(ends.format("safety.min_ttc_s")) == ["0", "≥ 23.8"]


def test_counts_above_lead_to_their_runs(browser: Browser) -> None:
    browser.run("document.querySelectorAll('button.count')[0].click()")
    assert browser.run(NAMES) == ["scene_0/7/idm/replay", "scene_3/7/idm/replay"]
    browser.run("document.querySelector('.stacked button.error').click()")
    assert browser.run(NAMES) == ["scene_4/7/idm/litsim"]
    tag = """[...document.querySelectorAll('button.count')].find((each) => each.dataset.filter.includes('"even"'))"""
    browser.run(f"{tag}.closest('tr').cells[2].querySelector('button').click()")
    assert browser.run(NAMES) == ["scene_4/7/idm/litsim", "scene_0/7/idm/litsim"]  # an error and a failure
    assert browser.run("document.getElementById('verdict').value") == "not passed"


def test_links_lead_to_the_moment_in_the_report_and_to_the_log(browser: Browser, folder: Path) -> None:
    picture = read_thumbnail(folder / "runs/repl000000000000")
    assert picture is not None
    start = 0.1 * picture["step"] - 1.0
    links = "[...document.querySelectorAll('#runs a')].map((a) => a.getAttribute('href'))"
    assert sorted(browser.run(links)) == [
        "runs/lits000000000004/ads.log",
        f"runs/repl000000000000/run/report.html#t={start:.1f}",
    ]


def test_pictures_are_drawn_and_the_strip_of_time_without_one(browser: Browser) -> None:
    choose(browser, "text", "replay")
    pixels = "c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer"
    canvases = "[...document.querySelectorAll('#runs tr[data-id] canvas')]"
    colours = sorted(browser.run(f"{canvases}.map((c) => new Set(new Uint32Array({pixels})).size)"))
    assert len(colours) == 6
    assert colours[-1] > 5 * colours[-2] and colours[0] > 2  # a scene; strips with takeovers and contacts


def test_a_run_opens_with_its_reasons_and_the_same_case_elsewhere(browser: Browser) -> None:
    choose(browser, "text", "scene_0 replay")
    browser.click(*browser.middle("#runs tr[data-id] button.run"))
    text = browser.run("document.getElementById('panel').innerText")
    assert "no contact at fault: collision.ego_at_fault is 1, expected at most 0" in text
    assert "idm, litsim" in text and "agent 7, driven by idm" in text
    browser.run("document.querySelector('#panel .alike button').click()")
    assert browser.run("document.querySelector('#panel h2').textContent") == "scene_0/7/idm/litsim"
    browser.press("Escape", 27)
    assert browser.run("document.getElementById('panel').hidden")


def test_keys_go_from_run_to_run(browser: Browser) -> None:
    heading(browser, "name")
    opened = "document.querySelector('#panel h2').textContent"
    for key, name in (("j", "scene_0/7/idm/litsim"), ("j", "scene_0/7/idm/replay"), ("k", "scene_0/7/idm/litsim")):
        browser.press(key, ord(key.upper()), key)
        assert browser.run(opened) == name
    assert browser.run("document.querySelector('#runs tr.current button.run').textContent") == "scene_0/7/idm/litsim"


def test_columns_are_chosen(browser: Browser) -> None:
    assert column(browser, "safety.min_ttc_s")
    for path, shown in (("safety.min_ttc_s", False), ("timing.wall_s", True)):
        browser.run(f"document.querySelector('#measures input[value=\"{path}\"]').click()")
        there = f"document.querySelector('#runs th[data-column=\"{path}\"]') !== null"
        assert browser.run(there) is shown


def test_the_address_keeps_the_view(chromium: Browser, page: Path) -> None:
    chromium.open(page)
    choose(chromium, "verdict", "failed")
    choose(chromium, "measure", "takeovers")
    choose(chromium, "high", "0")
    heading(chromium, "safety.min_ttc_s")
    heading(chromium, "safety.min_ttc_s")
    chromium.run("document.querySelector('#measures input[value=\"ego_motion.progress_ratio\"]').click()")
    chromium.run("campaign.open(campaign.selected[0])")
    names, address = chromium.run(NAMES), chromium.run("location.hash")
    assert names[0] == "scene_3/7/idm/replay"
    chromium.send("Page.navigate", url="about:blank")
    chromium.send("Page.navigate", url=page.resolve().as_uri() + address)
    chromium.wait("document.readyState === 'complete' && document.body.classList.contains('ready')")
    assert chromium.run(NAMES) == names
    assert chromium.run("document.getElementById('verdict').value") == "failed"
    assert chromium.run("document.querySelector('#panel h2').textContent") == names[0]
    assert chromium.run("document.querySelector('#runs th[data-column=\"ego_motion.progress_ratio\"]') === null")
    assert chromium.problems == []


def test_hundreds_of_runs(chromium: Browser, campaign: Write, tmp_path: Path) -> None:
    page = page_of(campaign(tmp_path, scenes=130))
    assert page.stat().st_size < 300_000
    chromium.open(page)
    assert chromium.run(SHOWN).startswith("260 of 260 runs: 1 error,")
    rows = "document.querySelectorAll('#runs tr[data-id]').length"
    assert 5 < chromium.run(rows) < 60  # those on the screen, and some to spare
    heading(chromium, "name")
    heading(chromium, "name")
    assert chromium.run(NAMES)[0] == "scene_129/7/idm/replay"  # by number, not by letter
    chromium.run("((box) => (box.scrollTop = box.scrollHeight))(document.getElementById('runs'))")
    chromium.wait(f"{NAMES}.at(-1) === 'scene_0/7/idm/litsim'")
    assert chromium.run(rows) < 60
    chromium.run("campaign.open(campaign.selected[130])")
    chromium.wait("document.querySelector('#runs tr.current') !== null")
    choose(chromium, "text", "scene_123/")
    assert chromium.run(NAMES) == ["scene_123/7/idm/replay", "scene_123/7/idm/litsim"]
    assert chromium.run("document.getElementById('runs').scrollTop") == 0
    assert chromium.problems == []


@pytest.mark.parametrize(("size", "dark"), [((1280, 720), True), ((390, 800), False)])
def test_layouts(chromium: Browser, page: Path, size: tuple[int, int], dark: bool) -> None:
    chromium.open(page, size=size, dark=dark)
    assert chromium.run("document.documentElement.scrollWidth") <= size[0]
    chromium.run("campaign.step(1)")
    box = chromium.run("(({left, right}) => [left, right])(document.getElementById('panel').getBoundingClientRect())")
    assert box[0] >= 0 and box[1] <= size[0]
    lightness = "getComputedStyle(document.getElementById('panel')).backgroundColor.match(/\\d+/g).map(Number)[0]"
    assert (chromium.run(lightness) < 60) is dark
    assert chromium.problems == []


def test_names_that_look_like_html_are_text(chromium: Browser, campaign: Write, tmp_path: Path) -> None:
    folder = campaign(tmp_path, scenes=2, criteria={"runs": [{"name": HOSTILE, "field": "takeovers", "min": 1000}]})
    file = folder / "campaign.json"
    values = json.loads(file.read_text())
    for case in values["cases"]:
        event = {"kind": HOSTILE, HOSTILE: HOSTILE}
        case |= {"name": HOSTILE, "label": HOSTILE, "tags": [HOSTILE], "scenario": HOSTILE, "events": [event]}
        case["parameters"] = {HOSTILE: HOSTILE}
    file.write_text(json.dumps(values))
    page = page_of(folder)
    chromium.open(page)
    chromium.run("campaign.open(campaign.selected[0])")
    assert chromium.run(NAMES)[0] == HOSTILE
    assert chromium.run("document.querySelector('#panel h2').textContent") == HOSTILE
    choose(chromium, "criterion", HOSTILE)
    assert chromium.run(SHOWN) == "4 of 4 runs: 4 failed"
    assert chromium.run("[document.images.length, document.scripts.length]") == [0, 2]
    assert chromium.run("document.title").startswith("made")
    assert chromium.problems == []
    assert {request.split("#")[0] for request in chromium.requests} == {page.resolve().as_uri()}
