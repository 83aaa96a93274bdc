"""Conversion of scenes to recordings: every source passes the checks of tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from litsim_data import segments
from litsim_data.generic.convert import RoughMotionError, convert
from litsim_data.generic.counts import Counts
from litsim_data.generic.mapping import Check
from litsim_data.generic.resampling import PIECE
from litsim_data.sources.source import Scene, Source
from litsim_sim.scenario.recording import Recording


def converted(
    scene: Scene, source: Source, *, raw: bool = False, accept: Sequence[Check] = ()
) -> tuple[Recording, Counts]:
    """Returns the tracks of a scene as a recording, and counts of the conversion.

    Args:
        scene: the scene.
        source: of which it is.
        raw: whether motion that is too noisy is kept, which is cleaned otherwise.
        accept: checks to skip, besides those of its mapping.

    Raises:
        InputError: the tracks cannot be used.
    """
    if isinstance(scene.tracks, Recording) or scene.mapping is None:
        assert isinstance(scene.tracks, Recording)
        rows = len(scene.tracks.columns["frame"])
        tracks = len(np.unique(scene.tracks.columns["vehicle_id"]))
        return scene.tracks, Counts(read=rows, rows=rows, tracks=tracks, pieces=tracks)
    licence, citation = scene.about or (source.licence, source.citation)
    header = {"name": scene.name, "source": citation, "licence": licence}
    skipped = {"accept": [*scene.mapping.accept, *accept]}
    mapping = scene.mapping.model_copy(update=header | skipped | ({"clean": False} if raw else {}))
    try:
        recording, counts = convert(scene.tracks, mapping)
    except RoughMotionError:  # few rows, but impossible
        if raw or mapping.clean is False:
            raise
        recording, counts = convert(scene.tracks, mapping.model_copy(update={"clean": True}))
        why = "accelerations were impossible; --raw keeps the motion"
        counts.tell("noisy", f"cleaned: {why}", noise=why)
    notes = recording.header.notes | counts.note() | _ego_note(scene, recording)
    return Recording(replace(recording.header, notes=notes), recording.columns), counts


def _ego_note(scene: Scene, recording: Recording) -> dict[str, object]:
    """Returns the note on the ego, if the scene knows it: the longest piece of its track, where this has holes."""
    if scene.ego is None:
        return {}
    ids = recording.header.notes.get("ids")
    number = ids[scene.ego] if isinstance(ids, Mapping) and scene.ego in ids else int(scene.ego)
    vehicle = recording.columns["vehicle_id"]
    pieces, rows = np.unique(vehicle[vehicle % PIECE == number], return_counts=True)
    return {segments.EGO_NOTE: int(pieces[np.argmax(rows)])} if len(pieces) else {}
