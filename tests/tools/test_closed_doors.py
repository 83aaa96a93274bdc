"""What a run loads holds no code, and asks nobody: no pickles, no network."""

import subprocess
import sys
from pathlib import Path

from safetensors import safe_open

SOURCES = Path(__file__).resolve().parents[2] / "src"
WITH_CODE = {".pt", ".pth", ".pkl", ".pickle", ".ckpt", ".joblib", ".npy", ".npz", ".bin"}
"""Endings of files that pickles hide in."""
ALONE = """
import os, sys

def listen(event, arguments):
    if event.startswith("socket.") and event not in ("socket.__new__", "socket.gethostname"):
        os.write(2, f"{event} {arguments}\\n".encode())
        os._exit(9)

sys.addaudithook(listen)
if "--ask" in sys.argv:
    import urllib.request
    urllib.request.urlopen("http://127.0.0.1:9/", timeout=1)
from litsim_eval.runs.in_process import record
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.report.thumbnails import write_thumbnail
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from pathlib import Path

run = record(RunPlan(Scenario.load("demo", simulation_s=0.5), "bat", "litsim"))
metrics = compute_metrics(run)
write_thumbnail(run, metrics, Path(sys.argv[1]))
print(metrics["steps"])
"""


def run_alone(*arguments: object) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", ALONE, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)


def test_a_run_and_its_measures_open_no_connection(tmp_path: Path) -> None:
    done = run_alone(tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert int(done.stdout) > 5


def test_a_connection_would_be_noticed(tmp_path: Path) -> None:
    done = run_alone(tmp_path, "--ask")
    assert done.returncode == 9 and done.stderr.startswith("socket.")


def test_weights_are_safetensors() -> None:
    files = [path for path in SOURCES.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert not [path for path in files if path.suffix in WITH_CODE]
    weights = [path for path in files if path.parent.name == "weights" and path.suffix not in (".py", ".md", ".json")]
    assert len(weights) >= 5
    for path in weights:
        assert path.suffix == ".safetensors"
        with safe_open(path, "numpy") as tensors:
            assert tensors.keys()
