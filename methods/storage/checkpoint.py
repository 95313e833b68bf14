"""A model on disk: one folder, one file of tensors; or in its place the smaller, lossy one of `storage/compact.py`."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from . import compact

FILE_NAME = "model.pt"


def write_checkpoint(folder: Path, method: str, state: dict) -> None:
    """Write `state` (tensors, numbers, and dictionaries of them) to folder/model.pt, atomically."""
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f"{FILE_NAME}.partial"
    torch.save({"method": method, **state}, partial)
    partial.replace(folder / FILE_NAME)


def read_checkpoint(folder: Path, method: str, device: torch.device) -> dict:
    """What `write_checkpoint` wrote, on `device`; where there is no model.pt, what `compact.write_compact` wrote.

    Raises:
        FileNotFoundError: there is neither.
        ValueError: the file cannot be read, or another method wrote it.
    """
    path = folder / FILE_NAME
    if not path.is_file() and (folder / compact.FILE_NAME).is_file():
        return on_device(compact.read_compact(folder, method), device)
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint: {path} does not exist")
    try:
        state = torch.load(path, map_location=device, weights_only=True)
        written_by = state["method"]
    except torch.OutOfMemoryError:
        raise
    except Exception as error:  # PyTorch raises whatever foreign bytes lead it to
        raise ValueError(f"{path} is not a readable checkpoint ({error}); train again or delete it") from error
    if written_by != method:
        raise ValueError(f"{path} holds a model of {written_by}, expected one of {method}")
    return state


def on_device(state: dict, device: torch.device) -> dict:
    """The state with its tensors on `device`."""

    def moved(value: object) -> object:
        if isinstance(value, Tensor):
            return value.to(device)
        return on_device(value, device) if isinstance(value, dict) else value

    return {name: moved(value) for name, value in state.items()}
