"""`data calibrate`: fit driver models to recorded traffic, and compare generated traffic with recorded windows."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import DATA_VARIABLE

COMPARED, COMPARED_SECONDS = 6, 140.5  # recordings, and the duration of each [s]
LAST_SEED_OF_CALIBRATION = 1000  # compared traffic has other seeds


def add(subparsers: Any) -> None:
    """Add the parser of the command."""
    command = subparsers.add_parser("calibrate", help="fit IDM and Krauss to recorded pairs, lane changes to windows")
    command.add_argument("--data", type=Path, help=f"folder of real data; default ${DATA_VARIABLE}")
    command.add_argument("--seed", type=int, default=0, help="default %(default)s")
    command.add_argument(
        "--out",
        type=Path,
        metavar="OUT.json",
        help="file of the calibrated parameters; without it, nothing is calibrated",
    )
    command.add_argument("--compare", action="store_true", help="compare generated traffic with the complete windows")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Calibrate, print the tables, write the parameters.

    Raises:
        InputError: data is missing, `out` cannot be written, or there is nothing to do.
    """
    if arguments.out is None and not arguments.compare:
        raise InputError("nothing to do: name a parameter file with --out, or ask for --compare")
    data = data_folder(arguments.data)
    if arguments.out is not None:
        from litsim_data.traffic import calibration_run

        began = time.perf_counter()
        print("fitting ...", file=sys.stderr)
        values = calibration_run.calibrate(data, arguments.seed, lambda line: print(line, flush=True))
        try:
            calibration_run.write(values, arguments.out)
        except OSError as error:
            raise InputError(f"{arguments.out}: cannot be written: {error.strerror or error}") from error
        print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr)
    if arguments.compare:
        print(compare(data, arguments.seed))


def compare(data: Path, seed: int) -> str:
    """Distances of generated traffic, with the packaged parameters and with SUMO's defaults, from the real windows.

    Raises:
        InputError: data is missing.
    """
    from litsim_data.traffic import comparison as synthetic_compare
    from litsim_data.traffic.drivers import SUMO_DEFAULT, calibrated
    from litsim_data.traffic.sites import US101_LIKE
    from litsim_data.traffic.synthetic import synthesize_all

    real = synthetic_compare.recorded(data)
    seeds = [LAST_SEED_OF_CALIBRATION + seed + number for number in range(COMPARED)]
    samples = []
    for behaviour in (calibrated(), SUMO_DEFAULT):
        print(f"simulating {COMPARED} times {COMPARED_SECONDS:g} s, {behaviour.name} ...", file=sys.stderr)
        made = synthesize_all(US101_LIKE, seeds, COMPARED_SECONDS, behaviour)
        samples.append((behaviour.name, synthetic_compare.generated(made)))
    return synthetic_compare.report(real, samples)


def data_folder(data: Path | None) -> Path:
    """The folder of real data: as given, or that of the environment.

    Raises:
        InputError: neither is there.
    """
    if data is None and not os.environ.get(DATA_VARIABLE):
        raise InputError(f"real data is needed: name its folder with --data, or set {DATA_VARIABLE}")
    return data or Path(os.environ[DATA_VARIABLE]).expanduser()
