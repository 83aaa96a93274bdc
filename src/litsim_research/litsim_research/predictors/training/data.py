"""The data of a training: where its files are, and their tracks by part."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from litsim_data.segments import Part
from litsim_research.predictors.data.sources import load
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.training.config import TrainingConfig
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import packaged

Parts = dict[Part, list[tuple[Tracks, float]]]
"""Tracks by part, each with the share of its frames that an epoch takes; a share above 1 repeats frames."""


class Locator:
    """Finds files named in a configuration: as given, in `folder`, under LITSIM_DATA, or in the package."""

    def __init__(self, folder: Path) -> None:
        data = os.environ.get("LITSIM_DATA")
        self._folders = [Path(), folder, *([Path(data)] if data else []), packaged("scenarios")]

    def __call__(self, name: str) -> Path:
        for folder in self._folders:
            if (folder / name).is_file():
                return folder / name
        raise InputError(f"{name}: no such file here, beside the configuration, or under LITSIM_DATA")


def load_parts(config: TrainingConfig, locate: Locator) -> Parts:
    """Returns the tracks of all sources, by part.

    Raises:
        InputError: see :func:`.sources.load`; or no source has anything for training or for validation.
    """
    parts: Parts = {"train": [], "val": [], "test": []}
    for source in config.data:
        for part, pieces in load(source, locate).items():
            parts[part] += [(tracks, source.share) for tracks in pieces if len(tracks)]
    if config.fraction < 1.0:
        random = np.random.default_rng(config.seed)
        for k, (tracks, share) in enumerate(parts["train"]):
            if not tracks.target.any():  # these have no targets, whatever the fraction
                continue
            fewer = tracks.learned_of(config.fraction, random)
            left = np.isin(tracks.frame, fewer.target_frames).mean()  # share of rows in frames that still have a target
            parts["train"][k] = fewer, share / float(left)
    for part in ("train", "val"):
        if not parts[part]:
            raise InputError(f"training configuration: field data: no source has anything for part {part}")
    return parts


def targets_of(parts: Parts) -> dict[str, dict[str, int]]:
    """Returns the number of rows of target vehicles, by part and then by the name of the tracks."""
    rows: dict[str, dict[str, int]] = {}
    for part, pieces in parts.items():
        for tracks, _ in pieces:
            counts = rows.setdefault(part, {})
            counts[tracks.name] = counts.get(tracks.name, 0) + int(tracks.target.sum())
    return rows
