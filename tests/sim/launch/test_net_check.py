"""A net that SUMO refuses is told with SUMO's reason, before any node starts."""

import re
import subprocess
from pathlib import Path

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.launch.net_check import begin_net_check
from litsim_sim.scenario.scenario import packaged

NET = packaged("nets/us101_like.net.xml")
ENDS = re.compile(r'<junction [^>]*type="dead_end"[^>]*/?>')
UNKNOWN = (
    '<edge id="q" from="a" to="b" priority="1"><lane id="q_0" index="0" speed="9" length="5" shape="0,0 5,0"/></edge>'
)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_a_net_that_sumo_loads_is_fine_and_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    net = tmp_path / "own.net.xml"
    net.write_text(NET.read_text())
    begin_net_check(net)()
    with monkeypatch.context() as context:
        context.delattr(subprocess, "Popen")
        begin_net_check(net)()
    net.write_text(ENDS.sub("", NET.read_text()))
    with pytest.raises(InputError):
        begin_net_check(net)()


def test_a_net_that_sumo_refuses_is_told_with_its_reason(tmp_path: Path) -> None:
    net = tmp_path / "own.net.xml"
    net.write_text(ENDS.sub("", NET.read_text()))
    with pytest.raises(InputError, match=rf"^{net}: SUMO cannot load the net: Unknown .*-node '.*' for edge '.*'"):
        begin_net_check(net)()


def test_a_net_that_crashes_sumo_is_told(tmp_path: Path) -> None:
    net = tmp_path / "own.net.xml"
    net.write_text(NET.read_text().replace("</net>", f"{UNKNOWN}</net>"))
    with pytest.raises(InputError, match=rf"^{net}: SUMO cannot load the net: "):
        begin_net_check(net)()


def test_packaged_nets_are_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(subprocess, "Popen")
    begin_net_check(NET)()
