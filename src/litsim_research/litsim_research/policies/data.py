"""Scenarios for training and validation: generated segments, and real windows on which no results are reported."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, model_validator

from litsim_data.encounters.following import PAIRS
from litsim_data.segments import MANIFEST_FILE, Manifest
from litsim_research.policies.following import following_scenarios, reported_drivers
from litsim_research.predictors.data.sources import digest_of
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_text
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.scenario import DATA_VARIABLE, Scenario

REPORTED = (316, 543)
"""First and last frame of the recording REPORTED_IN on which results are reported; excluded from training."""
REPORTED_IN = "us101_0750"  # named so by readers of all files that hold it

REAL_FILE = "ngsim/us101_0750_frames_0126_1149.parquet"
REAL_HISTORY_S = 1.1  # [s] the least that predictors need, since the windows are short
REAL_STAYS = 30  # steps after the history for which an ego must stay


class Generated(BaseModel):
    """Traffic from `data synthesize`.

    Attributes:
        net: packaged net.
        segments: number of segments of 28 s; their manifest splits them into training and validation.
        seed: neither that of scenario demo nor one of segments on which results are reported.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    net: str
    segments: int = Field(gt=0)
    seed: int = Field(ge=0)


class RealWindow(BaseModel):
    """A window of US-101 with all its vehicles.

    Attributes:
        frames: numbers of the first and the last frame; frames are 0.1 s apart.
        local_y_m: range along the road [m].
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    frames: tuple[int, int]
    local_y_m: tuple[float, float]

    @model_validator(mode="after")
    def _is_not_reported(self) -> RealWindow:
        if self.frames[0] <= REPORTED[1] and self.frames[1] >= REPORTED[0]:
            raise ValueError(f"frames {self.frames} overlap {REPORTED}, on which results are reported")
        return self


class DataConfig(BaseModel):
    """Sources of scenarios.

    Attributes:
        generated, real: see :class:`Generated` and :class:`RealWindow`.
        following: whether people's car following at hand is driven and learned from, too (:mod:`.following`).
        following_share: share of the draws of an episode's scenario that fall on it.
        real_weight: weight of a real window when a scenario is drawn, since they are few.
        scenarios: names or files of further scenarios for training.
        validation: names or files of further scenarios for validation.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    generated: tuple[Generated, ...] = ()
    real: tuple[RealWindow, ...] = ()
    following: bool = False
    following_share: float = Field(0.5, gt=0, lt=1)
    real_weight: int = Field(1, gt=0)
    scenarios: tuple[str, ...] = ()
    validation: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _is_apart(self) -> DataConfig:
        of_validation = {os.path.realpath(name) for name in self.validation}
        if both := [name for name in self.scenarios if os.path.realpath(name) in of_validation]:
            raise ValueError(f"{', '.join(both)} in both scenarios and validation, expected in one of them")
        return self


@dataclass(frozen=True)
class TrainingData:
    """Scenarios for training and for validation, at least one each; none is in both.

    Attributes:
        train, validation: the scenarios, some of them several times by their weight.
        real: names of the scenarios in which people drove.
        reported: ids of drivers whose reactions are reported on, by scenario; nothing is learned from these.
    """

    train: tuple[Scenario, ...]
    validation: tuple[Scenario, ...]
    real: frozenset[str] = frozenset()
    reported: Mapping[str, frozenset[int]] = field(default_factory=dict)

    @property
    def each_once(self) -> list[Scenario]:
        """The scenarios for training, without repetitions."""
        return list({scenario.name: scenario for scenario in self.train}.values())


def prepare(config: DataConfig, folder: Path) -> TrainingData:
    """Load the scenarios; generated ones are written to `folder` and reused.

    Raises:
        InputError: there is no scenario for training or for validation, or a recording cannot be used.
    """
    train: list[Scenario] = []
    validation: list[Scenario] = []
    for generated in config.generated:
        where = folder / f"{generated.net}_{generated.seed}_{generated.segments}"
        if not (where / MANIFEST_FILE).is_file():
            from litsim_data.traffic.segment_set import write_segment_set  # libsumo takes a moment to load

            write_segment_set(generated.net, generated.segments, generated.seed, where)
        for segment in Manifest.read(where / MANIFEST_FILE).segments:
            (train if segment.part == "train" else validation).append(Scenario.load(where / f"{segment.name}.yaml"))
    windows = [_real(window, folder) for window in config.real]
    train += windows * config.real_weight
    train += [_unreported(name) for name in config.scenarios]
    validation += [_unreported(name) for name in config.validation]
    following: list[Scenario] = []
    if config.following:
        following, followed = following_scenarios(_data_folder("following", PAIRS))
        train = _beside(train, following, config.following_share)
        validation = _beside(validation, followed, config.following_share)
    if not train:
        raise InputError("data: no scenario to train on, expected generated, real or scenarios")
    if not validation:
        raise InputError("data: no scenario to validate on, expected validation, or more generated segments")
    real = frozenset(scenario.name for scenario in [*windows, *following])
    reported = reported_drivers() if windows else frozenset()
    return TrainingData(tuple(train), tuple(validation), real, {window.name: reported for window in windows})


def _beside(others: list[Scenario], following: list[Scenario], share: float) -> list[Scenario]:
    """Returns both, the `others` so many times that draws fall on `following` with about the `share`."""
    times = round(len(following) * (1.0 - share) / share / max(len(others), 1))
    return others * max(times, 1) + following


def _data_folder(field: str, file: str) -> Path:
    """Returns the folder of published data.

    Raises:
        InputError: there is none; the message names the `field` of the configuration, and a `file` that it needs.
    """
    data = os.environ.get(DATA_VARIABLE, "")
    if not data:
        raise InputError(f"data: field {field}: {DATA_VARIABLE} is not set, expected a folder with {file}")
    return Path(data)


def _unreported(name: str) -> Scenario:
    """The scenario of that name or file, which must not be of the traffic on which results are reported."""
    scenario = Scenario.load(name)
    frames = scenario.recording.columns["frame"]
    if scenario.recording.header.name == REPORTED_IN and frames.min() <= REPORTED[1] and frames.max() >= REPORTED[0]:
        raise InputError(
            f"data: scenario {name}: frames {frames.min()} to {frames.max()} of {REPORTED_IN} overlap {REPORTED}, on "
            f"which results are reported"
        )
    return scenario


def _real(window: RealWindow, folder: Path) -> Scenario:
    """A scenario on a real window; its egos are all vehicles that are there from the start and stay long enough."""
    name = f"us101_{window.frames[0]}_{window.frames[1]}"
    crop = {"frame": [float(frame) for frame in window.frames], "local_y_m": list(window.local_y_m)}
    file = {
        "name": name,
        "recording": f"${{LITSIM_DATA}}/{REAL_FILE}",
        "crop": crop,
        "net": "us101",
        "history_s": REAL_HISTORY_S,
    }
    recording = load_recording(_data_folder("real", REAL_FILE) / REAL_FILE, crop)
    table = recording.table
    frames = table.groupby("vehicle_id")["frame"].agg(["min", "max"])
    needed = int(table["frame"].min()) + round(REAL_HISTORY_S * 10) + REAL_STAYS
    egos = frames[(frames["min"] == table["frame"].min()) & (frames["max"] >= needed)].index.tolist()
    if not egos:
        raise InputError(f"data: field real: no vehicle of frames {window.frames} stays for {REAL_STAYS} steps")
    path = folder / f"{name}.yaml"
    write_text(path, yaml.safe_dump(file | {"ego": egos[0], "egos": egos}, sort_keys=False))
    return Scenario.load(path)


FILES = ("recording", "net")
MOTION = ("vehicle_id", "frame", "x", "y", "yaw", "speed")


def described(data: TrainingData) -> dict[str, Any]:
    """Returns what the scenarios of `data` are, each once, in the order of the configuration.

    These are, of each, its name and fields, and the SHA-256 of its recording and net. Paths are left out, so that files
    may be moved, and so is the description.
    """
    parts = {"training": data.train, "validation": data.validation}
    once = {id(scenario): (part, scenario) for part, scenarios in parts.items() for scenario in scenarios}
    state: dict[str, Any] = {}
    for number, (part, scenario) in enumerate(once.values(), 1):
        fields = scenario.file.model_dump(mode="json", exclude={*FILES, "description", "name"})
        values = {name: _digest(scenario, Path(getattr(scenario.file, name))) for name in FILES}
        values |= {f"field {name}": value for name, value in fields.items()}
        state[f"{part} scenario {number}"] = scenario.name
        state |= {f"{name} of {part} scenario {number}, {scenario.name}": value for name, value in values.items()}
    return state


def _digest(scenario: Scenario, file: Path) -> str:
    """Returns the SHA-256 of a file; of the recorded motion where it is in memory only."""
    if file.is_file():
        return digest_of(file)
    columns = scenario.recording.columns
    return hashlib.sha256(b"".join(columns[name].tobytes() for name in MOTION)).hexdigest()
