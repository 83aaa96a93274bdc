"""Checkpoints of trainings and files of weights, written whole; checkpoints are read with errors that name the file."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing


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


def _brief(error: Exception) -> str:
    """Returns the kind of an error, and what torch says in the first sentence of its long messages."""
    return f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0].partition('. ')[0]}"
