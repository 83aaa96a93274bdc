"""What `colcon test` proves of the loop: the nodes find each other over this machine's DDS and finish a run."""

import subprocess
from pathlib import Path

from ament_index_python.packages import get_package_prefix

LAUNCH = Path(get_package_prefix("litsim_sim")) / "lib/litsim_sim/launch"


def test_the_demo_runs_over_dds_and_is_recorded(tmp_path: Path) -> None:
    options = ["--scenario", "demo", "--ego", "idm", "--policy", "litsim", "--out", tmp_path / "demo"]
    run = subprocess.run([LAUNCH, *options], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert len(list(tmp_path.glob("demo/*.mcap"))) == 1
