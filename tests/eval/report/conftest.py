"""Small runs for reports, and a headless Chromium that is driven over a pipe, without a driver or a port."""

import base64
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns import cases, suite
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.campaign.case import Case
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import RunResult
from litsim_sim.core.scene import AgentTable, Controller
from litsim_sim.core.takeover import Takeover, TakeoverState
from litsim_sim.record.run import Run
from litsim_sim.scenario.run_info import IN_PROCESS
from made_agents import takeover
from made_runs import make_run, table
from patience import PATIENCE_S

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
NET = Path(__file__).resolve().parents[3] / "src/litsim_sim/litsim_sim/nets/us101_like.net.xml"
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--remote-debugging-pipe"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
    *("--disable-extensions", "--no-default-browser-check", "--hide-scrollbars", "--force-prefers-reduced-motion"),
)
STEPS, HISTORY, TAKEN = 60, 10, (20, 45)
EGO, FOLLOWER, OTHER = 1, 2, 3
CAMPAIGN_CRITERIA = Criteria(
    runs=[
        {"name": "no contact at fault", "field": "collision.ego_at_fault", "max": 0},
        {"name": "time to collision", "field": "safety.min_ttc_s", "min": 0.3},
        {"field": "takeovers", "max": 100},
    ]
)


class Chromium:
    """One page of a headless browser; speaks the DevTools protocol over file descriptors 3 and 4."""

    def __init__(self, program: str, profile: Path) -> None:
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()
        # The browser reads commands from descriptor 3 and answers on 4; bash moves ours there.
        shuffle = f'exec "$0" "$@" 3<&{to_browser} 4>&{from_browser}'
        command = ["bash", "-c", shuffle, program, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        said = (profile.parent / "chromium.log").open("wb")
        self._process = subprocess.Popen(
            command, pass_fds=(to_browser, from_browser), stdin=subprocess.DEVNULL, stdout=said, stderr=said
        )
        said.close()
        os.close(to_browser)
        os.close(from_browser)
        self._number, self._rest, self._session = 0, b"", ""
        self.problems: list[str] = []
        self.requests: list[str] = []
        pages = self.send("Target.getTargets")["targetInfos"]
        target = next(each["targetId"] for each in pages if each["type"] == "page")
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def close(self) -> None:
        self._process.terminate()
        self._process.wait(PATIENCE_S)
        os.close(self._out)
        os.close(self._in)

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command; events that come before it are noted."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            found = self._receive(PATIENCE_S)
            if found.get("id") == self._number:
                assert "error" not in found, found
                result: dict[str, Any] = found["result"]
                return result

    def _receive(self, patience: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._in], [], [], patience)
            assert ready, "the browser does not answer"
            data = os.read(self._in, 1 << 20)
            assert data, "the browser has gone"
            self._rest += data
        raw, self._rest = self._rest.split(b"\0", 1)
        message: dict[str, Any] = json.loads(raw)
        self._note(message)
        return message

    def _note(self, message: dict[str, Any]) -> None:
        method, about = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.problems.append(str(about["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
            self.problems.append(str(about["args"]))
        elif method == "Log.entryAdded" and about["entry"]["level"] in ("error", "warning"):
            self.problems.append(about["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])

    def open(self, path: Path, size: tuple[int, int] = (1280, 720), dark: bool = False) -> None:
        """Open a page and wait until it is ready, which pages with scripts say."""
        self.problems.clear()
        self.requests.clear()
        self.send(
            "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", features=[scheme])
        self.send("Page.navigate", url=path.resolve().as_uri())
        ready = "(document.scripts.length === 0 || document.body.classList.contains('ready'))"
        self.wait(f"document.readyState === 'complete' && {ready}")

    def run(self, expression: str) -> Any:
        """Value of a JavaScript expression."""
        answer = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, expression: str, patience: float = PATIENCE_S) -> None:
        """Wait until an expression holds."""
        end = time.monotonic() + patience
        while not self.run(expression):
            assert time.monotonic() < end, f"not within {patience} s: {expression}; {self.problems}"
            time.sleep(0.05)

    def press(self, key: str, code: int, text: str = "", modifiers: int = 0) -> None:
        """Press and release a key; `code` is its virtual key code."""
        both = {"key": key, "windowsVirtualKeyCode": code, "modifiers": modifiers}
        self.send("Input.dispatchKeyEvent", type="keyDown", **both, **({"text": text} if text else {}))
        self.send("Input.dispatchKeyEvent", type="keyUp", **both)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y, button="left", clickCount=1)

    def middle(self, selector: str) -> tuple[float, float]:
        """Middle of an element on the screen, brought there first."""
        box = f"document.querySelector({json.dumps(selector)})"
        self.run(f"{box}.scrollIntoView({{block: 'nearest'}})")
        x, y, w, h = self.run(f"(({{x, y, width, height}}) => [x, y, width, height])({box}.getBoundingClientRect())")
        return x + w / 2, y + h / 2

    def screenshot(self, path: Path) -> None:
        shot = self.send("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(shot["data"]))


@pytest.fixture(scope="session")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium on PATH (Debian: apt install chromium); the page is tested without a browser only")
    browser = Chromium(program, tmp_path_factory.mktemp("chromium") / "profile")
    yield browser
    browser.close()


def _table(step: int, log: bool) -> AgentTable:
    """A road with the ego, which brakes, its follower, which is taken over for a while, and many others."""
    t = 0.1 * step
    rows: list[dict[str, Any]] = [
        {"id": k + 1, "x": 20.0 + 14.0 * (k // 5) + 8.0 * t, "y": -3.66 * (k % 5 + 0.5), "speed": 8.0, "length": 4.5}
        for k in range(150)
    ]
    ego, follower = rows[:2]
    follower |= {"x": ego["x"] - 12.0, "y": ego["y"]}
    if not log:
        late = max(0.0, t - 1.0)
        ego |= {"x": ego["x"] - 0.5 * late**2, "speed": 8.0 - late, "controller": Controller.EGO}
        if TAKEN[0] <= step <= TAKEN[1]:
            follower |= {"x": follower["x"] - 0.3 * (t - 2.0), "controller": Controller.POLICY}
    return table(step, *rows)


def _record(step: int) -> Takeover:
    back = step > TAKEN[1] - 10
    return takeover(
        FOLLOWER,
        EGO,
        state=TakeoverState.HANDBACK if back else TakeoverState.HELD,
        detected_step=TAKEN[0],
        time_to_conflict=2.5,
        overlap_probability=0.4,
        conflict_pose=(50.0, -1.83, 0.0),
        goal_pose=(60.0, -1.83, 0.0),
        reference_path=np.stack([np.linspace(10.0, 90.0, 81), np.full(81, -1.83)], axis=1),
        residual_position=0.5,
        residual_speed=0.25,
    )


@pytest.fixture(scope="session")
def small_run() -> Run:
    steps = range(STEPS + 1)
    return make_run(
        [_table(k, log=False) for k in steps],
        [_table(k, log=True) for k in steps],
        run_id="made-idm-litsim",
        scenario="made <&>",
        history_steps=HISTORY,
        mode=IN_PROCESS,
        versions="python: 3.11.7\n",
        takeovers={k: [_record(k)] if TAKEN[0] <= k <= TAKEN[1] else [] for k in steps},
        net_xml=NET.read_bytes(),
    )


@pytest.fixture(scope="session")
def campaign(small_run: Run) -> Callable[..., Path]:
    """Writes the folder of a campaign: scenes with an ego under two policies, judged by three criteria.

    Of scene k, with the tag `even` or `odd`, the ego's shortest TTC is 0.2 k seconds, and its progress ratio
    0.5 + 0.01 k. Under replay it is at fault where k is a multiple of 3. Under litsim, scene 4 is an error, and
    takeovers number k.
    """
    measured: dict[str, Any] = json.loads(json.dumps(compute_metrics(small_run)))
    (one,) = cases(policies=["replay"])

    def case(k: int, policy: str) -> Case:
        name, tags = f"scene_{k}", ("even",) if k % 2 == 0 else ("odd",)
        known = {"id": f"{policy[:4]:x<4}{k:012d}", "name": f"{name}/7/idm/{policy}", "scenario": name, "tags": tags}
        return replace(one, policy=policy, ego_id=7, **known)

    def metrics(k: int, policy: str) -> dict[str, Any]:
        at_fault = int(policy == "replay" and k % 3 == 0)
        return measured | {
            "collision": measured["collision"] | {"ego_at_fault": at_fault},
            "safety": measured["safety"] | {"min_ttc_s": 0.2 * k},
            "ego_motion": measured["ego_motion"] | {"progress_ratio": 0.5 + 0.01 * k},
            "takeovers": k if policy == "litsim" else 0,
        }

    def write(folder: Path, scenes: int = 6, done: int | None = None, **suite_values: Any) -> Path:
        every = [case(k, policy) for policy in ("replay", "litsim") for k in range(scenes)]
        plan = suite(
            **({"name": "made", "policies": ["replay", "litsim"], "criteria": CAMPAIGN_CRITERIA} | suite_values)
        )
        made = CampaignFolder(folder)
        made.begin(plan, every, {"python": "3.12", "commit": "abc"})
        for each in every[:done]:
            k = int(each.scenario.split("_")[1])
            made.clear(each)
            if (k, each.policy) == (4, "litsim"):
                made.store(RunResult.error(each, "the stack ended: no weights", log="ads.log", wall_s=1.5))
            else:
                files = {"report": "run/report.html", "recording": "run", "wall_s": 2.0 + k}
                made.store(RunResult.judged(each, metrics(k, each.policy), plan.criteria, **files))
        return folder

    return write
