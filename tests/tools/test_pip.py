"""`pip install .`: one wheel that runs, measures and reports without ROS, as a workspace does."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from litsim_eval.analysis.measures.identity import digest
from litsim_eval.runs.in_process import record
from litsim_sim.scenario.run_info import RunPlan

ROOT = Path(__file__).resolve().parents[2]
OF_ROS = r"ament_|builtin_interfaces|domain_coordinator|\w+_msgs\b|rcl|rosgraph|rosidl|rpyutils|std_srvs"
"""Begins the names of modules of ROS and of the workspace, which are not there in a plain environment."""
WITHOUT_ROS = f"""
import re, sys

class WithoutRos:
    def find_spec(self, name, path=None, target=None):
        if re.match(r"{OF_ROS}", name):
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, WithoutRos())
"""
HERE = {"run", "evaluate", "report", "analyze", "compare", "data", "train", "score", "export", "paper", "compile"}
BAG = ROOT / "tests/sim/record/bags/format_1"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout in a folder of its own, built by pip from a copy and without a network."""
    source, site = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("site")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.rstrip("\0").split("\0"):
        if re.match("(src|tools|requirements)/|[^/]+$", name) and (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*install, "--target", str(site), str(source)], check=True)
    (site / "sitecustomize.py").write_text(WITHOUT_ROS)
    for package in ROOT.glob("src/*/litsim_*"):  # machine code, which need not be compiled once more
        for kernel in package.rglob("*.kernel"):
            if (place := site / kernel.relative_to(package.parent)).parent.is_dir():
                shutil.copy(kernel, place)
    return site


@pytest.fixture(scope="module")
def campaign(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "campaign"
    words = ("--scenario", "demo", "--ego-id", "6", "--ego", "idm", "--policy", "litsim", "--out", out)
    assert litsim(site, "evaluate", *words).returncode == 0
    return out


def litsim(site: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """A finished `litsim` of the wheel."""
    command = [sys.executable, str(site / "bin/litsim"), *map(str, words)]
    return subprocess.run(command, env=bare(site), cwd=site.parent, capture_output=True, text=True, check=False)


def bare(site: Path) -> dict[str, str]:
    """An environment without the modules of the workspace and of ROS."""
    plain = {
        name: value for name, value in os.environ.items() if not name.startswith(("AMENT", "COLCON", "ROS", "LITSIM"))
    }
    return plain | {"PYTHONPATH": str(site)}


def test_the_wheel_has_every_file_of_the_packages(site: Path) -> None:
    listed = subprocess.run(["git", "ls-files", "src"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [Path(name) for name in listed.split()]
    inside = [file.relative_to(Path("src") / file.parts[1]) for file in files if file.parts[1] == file.parts[2]]
    assert len(inside) > 300
    missing = [
        str(file) for file in inside if not (site / file).is_file() and (ROOT / "src" / file.parts[0] / file).is_file()
    ]
    assert not missing, "pyproject.toml, package-data"


def test_the_version_is_the_same_everywhere() -> None:
    (version,) = re.findall(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    for file in ROOT.glob("src/*/package.xml"):
        assert f"<version>{version}</version>" in file.read_text(), file
    assert f'version="{version}"' in (ROOT / "src/litsim_autoware/setup.py").read_text()
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[1] == version
    assert f"litsim_ros-{version}-py3-none-any.whl" in (ROOT / "README.md").read_text()


def test_its_entry_points_are_those_of_the_packages(site: Path) -> None:
    (packed,) = site.glob("litsim_ros-*.dist-info/entry_points.txt")
    for package in ("litsim_sim", "litsim_policy", "litsim_research"):
        for line in re.findall(rf'"(\w+ = {package}\.[\w.:]+)"', (ROOT / f"src/{package}/setup.py").read_text()):
            assert f"\n{line}\n" in packed.read_text()


def test_a_run_is_that_of_the_workspace(site: Path, tmp_path: Path) -> None:
    done = litsim(site, "run", "--scenario", "demo", "--ego", "idm", "--out", tmp_path / "pip")
    assert done.returncode == 0, done.stderr
    here = digest(record(RunPlan.load("demo", "idm", "litsim")))
    assert json.loads((tmp_path / "pip/metrics.json").read_text())["digest"] == here
    for name in ("report.html", "series.parquet", "takeovers.parquet", "overview.png"):
        assert (tmp_path / "pip" / name).stat().st_size > 1000


def test_campaign_and_its_page(site: Path, campaign: Path) -> None:
    assert json.loads((campaign / "results.json").read_text())["verdict"] == "passed"
    for name in ("results.parquet", "junit.xml", "experiment.html"):
        assert (campaign / name).stat().st_size > 0
    (campaign / "experiment.html").unlink()
    assert litsim(site, "report", campaign).returncode == 0 and (campaign / "experiment.html").is_file()
    assert litsim(site, "compare", campaign, campaign).returncode == 0


def test_a_record_is_measured_and_shown(site: Path, tmp_path: Path) -> None:
    bag = shutil.copytree(BAG, tmp_path / "bag")
    done = litsim(site, "analyze", bag)
    assert done.returncode == 0, done.stderr
    assert litsim(site, "report", bag).returncode == 0
    assert (bag / "metrics.json").is_file() and (bag / "report.html").is_file()


def needs_ros(done: subprocess.CompletedProcess[str]) -> bool:
    line = rf"error: this needs ROS 2, and there is no ({OF_ROS})\w* here: .*\n"
    return done.returncode == 2 and re.fullmatch(line, done.stderr) is not None


def test_what_works_without_ros_imports_nothing_of_it(site: Path) -> None:
    code = f"""
from litsim_sim.core import plugins
verbs = plugins.installed(plugins.VERBS)
for verb in {sorted(HERE)}:
    verbs[verb].load()
"""
    done = subprocess.run([sys.executable, "-c", code], env=bare(site), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("verb", ["launch --help", "replay --help", "ego", "evaluate --graph --out campaign"])
def test_what_needs_ros_on_the_way_says_so(site: Path, verb: str) -> None:
    assert needs_ros(litsim(site, *verb.split()))


def test_a_failed_run_is_run_again_by_the_command_that_is_named(site: Path, tmp_path: Path) -> None:
    words = (
        "--scenario",
        "demo",
        "--ego-id",
        "6",
        "--ego",
        "idm",
        "--policy",
        "replay",
        "--set",
        "ego.headway=1.2",
    )
    done = litsim(site, "evaluate", *words, "--out", tmp_path / "failed")
    assert done.returncode == 1, done.stderr
    ((name, *again),) = (shlex.split(line) for line in done.stderr.splitlines() if "--out" in line)
    rerun = litsim(site, *again)
    assert (name, rerun.returncode, rerun.stderr[-200:]) == ("litsim", 0, rerun.stderr[-200:])
    (page,) = tmp_path.glob("failed/reruns/*/report.html")
    assert json.loads((page.with_name("metrics.json")).read_text())["collision"]["excess"] > 0


def test_unknown_verbs_are_told_with_those_that_there_are(site: Path) -> None:
    done = litsim(site, "drive")
    assert done.returncode == 2 and "no verb 'drive'; there are: launch run" in done.stderr


def test_an_import_of_ros_would_be_noticed(site: Path) -> None:
    words = [sys.executable, "-c", "import rclpy"]
    done = subprocess.run(
        words, env=os.environ | {"PYTHONPATH": str(site)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and "No module named 'rclpy'" in done.stderr
