"""A model on disk: one folder, one file of tensors."""

from __future__ import annotations

from pathlib import Path

import torch

FILE_NAME = "model.pt"


def write_checkpoint(folder: Path, method: str, state: dict) -> None:
    """Write `state` (tensors, numbers, and dictionaries of them) to folder/model.pt, atomically."""
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f"{FILE_NAME}.partial"
    torch.save({"method": method, **state}, partial)
    partial.replace(folder / FILE_NAME)


def read_checkpoint(folder: Path, method: str, device: torch.device) -> dict:
    """What `write_checkpoint` wrote, on `device`.

    Raises:
        FileNotFoundError: there is no model.pt.
        ValueError: the file cannot be read, or another method wrote it.
    """
    path = folder / FILE_NAME
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
