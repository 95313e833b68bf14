"""Snapshots: all that a training's next step depends on, in one file, from which an interrupted run goes on.

The file is safetensors: the tensors, and as its metadata the JSON of everything else. It is written beside the old one
and then takes its place, so that there is always a whole one. Nothing in it is executed.
"""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from envgs_bench.run_folder import SNAPSHOT_NAME

from .stop import Stop

LAYOUT = 2
TENSOR = "tensor"  # the key of a tensor's name in the JSON

State = dict[str, Any]  # tensors, numbers, strings, None, and lists and dictionaries of them


class Snapshots:
    """The snapshot of the run in `folder`, saved every `minutes` and when the run is asked to end.

    Attributes:
        seconds: what saving took so far, in this process.
    """

    def __init__(self, folder: Path, minutes: float, stop: Stop) -> None:
        self.stop = stop
        self.seconds = 0.0
        self._path = folder / SNAPSHOT_NAME
        self._every = 60 * minutes
        self._saved = time.monotonic()

    @property
    def is_due(self) -> bool:
        return self.stop.wanted or time.monotonic() - self._saved > self._every

    def save(self, state: Callable[[], State | None]) -> None:
        """Save what `state()` returns, nothing where that is None. A full disk costs the snapshot, not the run."""
        began = time.monotonic()
        content = state()
        if content is not None:
            try:
                write_state(self._path, content)
            except (OSError, SafetensorError) as error:
                print(f"no snapshot could be saved: {error}", flush=True)
        self._saved = time.monotonic()
        self.seconds += self._saved - began

    def read(self) -> State | None:
        """The state that was saved last, None where there is none that can be read."""
        if not self._path.is_file():
            return None
        try:
            return read_state(self._path)
        except ValueError as error:
            print(f"{error}; the training starts again", flush=True)
            return None

    def remove(self) -> None:
        """The run is finished."""
        self._path.unlink(missing_ok=True)
        _part_of(self._path).unlink(missing_ok=True)  # of a process that was killed while it saved


def write_state(path: Path, state: State) -> None:
    """Write `state` to `path`, which holds the old content or the new whenever the process ends.

    Raises:
        OSError, SafetensorError: it cannot be written.
    """
    tensors: dict[str, Tensor] = {}

    def reduced(value: Any) -> Any:
        if isinstance(value, Tensor):
            name = str(len(tensors))
            tensors[name] = value.detach().cpu().contiguous()
            return {TENSOR: name}
        if isinstance(value, dict):
            return {key: reduced(part) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [reduced(part) for part in value]
        return value

    text = json.dumps({"layout": LAYOUT, "state": reduced(state)})
    part = _part_of(path)
    try:
        save_file(_apart(tensors), part, metadata={"json": text})
        with part.open("rb") as stream:
            os.fsync(stream.fileno())
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _part_of(path: Path) -> Path:
    """Where the file lies until it is whole."""
    return path.with_name(f".{path.name}.part")


def read_state(path: Path) -> State:
    """What `write_state` wrote, tensors on the CPU.

    Raises:
        ValueError: it is no such file, or of another layout; the message names it.
    """
    try:
        with safe_open(path, framework="pt") as file:
            content = json.loads((file.metadata() or {})["json"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (it is no mapping)
        if content["layout"] != LAYOUT:
            raise ValueError(f"its layout is {content['layout']}, this version writes {LAYOUT}")

        def restored(value: Any) -> Any:
            if isinstance(value, dict):
                if value.keys() == {TENSOR}:
                    return tensors[value[TENSOR]]
                return {key: restored(part) for key, part in value.items()}
            return [restored(part) for part in value] if isinstance(value, list) else value

        return restored(content["state"])
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is no snapshot that can be read ({error})") from error


def random_state() -> State:
    """The state of the global generators of Python, NumPy and PyTorch on the CPU."""
    version, internal, gauss = random.getstate()
    kind, keys, position, has_gauss, cached = np.random.get_state()  # noqa: NPY002 (the global one, for libraries)
    return {
        "python": [version, list(internal), gauss],
        "numpy": [str(kind), torch.from_numpy(np.asarray(keys).astype(np.int64)), int(position), has_gauss, cached],
        "torch": torch.get_rng_state(),
    }


def set_random_state(state: State) -> None:
    """Become what `random_state` returned."""
    version, internal, gauss = state["python"]
    random.setstate((version, tuple(internal), gauss))
    kind, keys, *rest = state["numpy"]
    np.random.set_state((kind, keys.numpy().astype(np.uint32), *rest))  # noqa: NPY002
    torch.set_rng_state(state["torch"])


def _apart(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The tensors, those copied whose memory another has too: safetensors stores each alone."""
    seen: set[int] = set()
    apart = {}
    for name, tensor in tensors.items():
        place = tensor.untyped_storage().data_ptr()
        shared = place in seen or tensor.untyped_storage().nbytes() != tensor.nbytes
        apart[name] = tensor.clone() if shared else tensor
        seen.add(place)
    return apart
