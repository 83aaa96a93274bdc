"""Checkpoints of trainings, of which each can be resumed, and files of weights; all are written whole."""

from __future__ import annotations

import io
import json
import textwrap
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import torch
from safetensors.torch import save

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing

CHECKPOINT = "checkpoint.pt"
SHOWN = 70  # most characters of a value in an error, of which a SHA-256 has 66


class ResumableTraining:
    """A training whose state can be written between two epochs or iterations, and restored.

    Attributes:
        config: of the training.
        data: what it is trained on: by file or field its SHA-256 or value.
        history: measured values by name, one entry per epoch, iteration or validation.
        parts, more: names of the attributes that a checkpoint holds: networks and optimisers, and all others.
        length: field of the configuration that may be another one when the training is resumed; empty for none.
        device: of torch.
    """

    config: Any
    data: dict[str, Any]
    history: list[dict[str, float]]
    parts: tuple[str, ...]
    more: tuple[str, ...]
    length: ClassVar[str] = "iterations"
    device = "cpu"

    def keep(self, out: Path) -> None:
        """Write a checkpoint to the folder `out`, with the configuration and what the data are.

        Raises:
            Unwritable: the file cannot be written; the previous checkpoint is kept.
        """
        state = {name: getattr(self, name).state_dict() for name in self.parts}
        state |= {name: getattr(self, name) for name in self.more}
        described = {"config": json.dumps(self.config.model_dump(mode="json")), "data": json.dumps(self.data)}
        save_checkpoint(out / CHECKPOINT, state | described)

    def read(self, path: Path) -> None:
        """Restore the state from the checkpoint `path`.

        Raises:
            InputError: there is none, or it is of a run with another configuration, of which only the field
                :attr:`length` may differ, or with other data.
        """
        with checkpoint(path, self.device) as state:
            then, now = json.loads(state["config"]), self.config.model_dump(mode="json")
            changed = [key for key in now if key != self.length and then.get(key) != now[key]]
            if changed:
                differ = f"fields {', '.join(changed)} of the configuration differ from the checkpoint's"
                raise InputError(f"{path}: {differ}")
            then, now = json.loads(state["data"]), json.loads(json.dumps(self.data))
            for name in (*now, *then):
                if (actual := now.get(name)) != (expected := then.get(name)):
                    values = f"{_shown(actual)}, expected {_shown(expected)}"
                    raise InputError(
                        f"{path}: trained on another {name}: {values}; restore it, or train anew elsewhere"
                    )
            for name in self.parts:
                getattr(self, name).load_state_dict(state[name])
            for name in self.more:
                setattr(self, name, state[name])


@contextmanager
def checkpoint(path: Path, device: str) -> Iterator[dict[str, Any]]:
    """The content of the checkpoint `path`, its tensors on a `device` of torch, to be restored in the block.

    Raises:
        InputError: there is none, it cannot be read, or the block does not find in it what it expects, as in that of
            another program or version.
    """
    if not path.is_file():
        raise InputError(f"{path}: no checkpoint to resume from")
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except Exception as error:
        raise InputError(f"{path}: not a readable checkpoint: {_brief(error)}") from error
    try:
        yield state
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise InputError(f"{path}: a checkpoint of another program or version: {_brief(error)}") from error


def save_checkpoint(path: Path, state: Mapping[str, Any]) -> None:
    """Write the checkpoint `path`.

    Raises:
        Unwritable: it cannot be written; the previous one is kept.
    """
    content = io.BytesIO()  # given a file, torch does not say that the disk is full
    torch.save(dict(state), content)
    with replacing(path) as new:
        new.write_bytes(content.getvalue())  # Python 3.12.1 crashes on views that outlive an error


def save_weights(tensors: Mapping[str, torch.Tensor], metadata: dict[str, str], path: Path) -> None:
    """Write the safetensors file `path`.

    Raises:
        Unwritable: it cannot be written; what was there is kept.
    """
    with replacing(path) as new:
        new.write_bytes(save({name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}, metadata))


def _shown(value: Any) -> str:
    return "none" if value is None else textwrap.shorten(json.dumps(value), SHOWN, placeholder=" …")


def _brief(error: Exception) -> str:
    """Returns the kind of an error, and what torch says in the first sentence of its long messages."""
    return f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0].partition('. ')[0]}"
