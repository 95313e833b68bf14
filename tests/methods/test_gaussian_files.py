"""Files of Gaussians as other programs write them: what gaussforge encoded comes back, and damage is named."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import normalize

from envgs_bench.methods.storage.gaussian_files import read_gaussian_file
from envgs_bench.methods.storage.ply import write_ply
from envgs_bench.methods.storage.splats import encode_splats
from envgs_bench.methods.storage.spz_file import HEADER

REST = (0, 3, 8, 15)


def some(count: int = 400, degree: int = 3) -> dict[str, Tensor]:
    """Gaussians in no order."""
    random = torch.Generator().manual_seed(degree)
    return {
        "means": 2 * torch.randn(count, 3, generator=random),
        "quaternions": normalize(torch.randn(count, 4, generator=random), dim=1),
        "log_scales": torch.randn(count, 3, generator=random) - 3,
        "opacity_logits": torch.randn(count, generator=random),
        "sh_dc": torch.randn(count, 1, 3, generator=random) / 2,
        "sh_rest": torch.randn(count, REST[degree], 3, generator=random) / 10,
    }


def in_order_of(found: dict[str, Tensor], tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The set that was encoded, its rows as the file has them: encoders sort."""
    rows = cKDTree(tensors["means"].numpy()).query(found["means"].numpy())[1]
    assert len(set(rows)) == len(tensors["means"])
    return {name: values[torch.from_numpy(rows)] for name, values in tensors.items()}


def turned(ours: Tensor, theirs: Tensor) -> float:
    """The largest angle between rotations, degrees."""
    cosine = (ours * normalize(theirs, dim=1)).sum(dim=1).abs().clamp(max=1)
    return float(torch.rad2deg(2 * torch.acos(cosine)).max())


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_spz_of_another_encoder_comes_back(tmp_path: Path, degree: int) -> None:
    tensors = some(degree=degree)
    (tmp_path / "a.spz").write_bytes(encode_splats("spz", tensors))
    found = read_gaussian_file(tmp_path / "a.spz")
    tensors = in_order_of(found, tensors)
    assert float((found["means"] - tensors["means"]).abs().max()) < 1 / 4096
    assert turned(found["quaternions"], tensors["quaternions"]) < 0.4
    assert float((found["log_scales"] - tensors["log_scales"]).abs().max()) <= 1 / 32 + 1e-6
    assert float((found["opacity_logits"].sigmoid() - tensors["opacity_logits"].sigmoid()).abs().max()) < 1 / 255
    assert float((found["sh_dc"] - tensors["sh_dc"]).abs().max()) < 1 / 255 / 0.15
    assert found["sh_rest"].shape == tensors["sh_rest"].shape
    assert not degree or float((found["sh_rest"] - tensors["sh_rest"]).abs().max()) < 0.07  # 4 bits from degree 2 on


def test_spz_of_version_2_has_rotations_of_three_bytes(tmp_path: Path) -> None:
    """Written by hand: one Gaussian at (1, −2, 0.5) in SPZ's axes, turned by 90° about its x axis."""
    body = b"".join(struct.pack("<i", round(x * 4096))[:3] for x in (1, -2, 0.5))
    body += bytes([128, 255, 128, 0, 160, 144, 176]) + bytes([round((2**-0.5 + 1) * 127.5), 128, 128])
    (tmp_path / "a.spz").write_bytes(gzip.compress(HEADER.pack(b"NGSP", 2, 1, 0, 12, 0, 0) + body))
    found = read_gaussian_file(tmp_path / "a.spz")
    assert found["means"][0].tolist() == [1, 2, -0.5]
    assert found["log_scales"][0].tolist() == [0, -1, 1]
    # A half turn about x before it: 90° + 180°.
    assert turned(found["quaternions"], torch.tensor([[np.cos(np.radians(135)), np.sin(np.radians(135)), 0, 0]])) < 1
    assert found["sh_dc"][0, 0].tolist() == pytest.approx([0.5 / 0.15, 0, -0.5 / 0.15], abs=0.02)


@pytest.mark.parametrize("degree", [0, 3])
def test_sog_of_another_encoder_comes_back_packed_or_as_a_folder(tmp_path: Path, degree: int) -> None:
    tensors = some(degree=degree)
    content = encode_splats("sog", tensors)
    (tmp_path / "a.sog").write_bytes(content)
    zipfile.ZipFile(io.BytesIO(content)).extractall(tmp_path / "folder")
    found = read_gaussian_file(tmp_path / "a.sog")
    again = read_gaussian_file(tmp_path / "folder" / "meta.json")
    assert all(torch.equal(found[name], again[name]) for name in found)
    tensors = in_order_of(found, tensors)
    assert float((found["means"] - tensors["means"]).abs().max()) < 1e-3
    assert turned(found["quaternions"], tensors["quaternions"]) < 0.8
    assert float((found["log_scales"] - tensors["log_scales"]).abs().mean()) < 0.02
    assert float((found["opacity_logits"].sigmoid() - tensors["opacity_logits"].sigmoid()).abs().max()) < 1 / 255
    assert float((found["sh_dc"] - tensors["sh_dc"]).abs().mean()) < 0.01
    assert found["sh_rest"].shape == tensors["sh_rest"].shape


def test_a_ply_is_read_as_ever(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", some())
    assert torch.equal(read_gaussian_file(tmp_path / "a.ply")["means"], some()["means"])


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
@pytest.mark.parametrize("layout", ["spz", "sog"])
def test_a_file_that_ends_early_is_named(tmp_path: Path, layout: str, share: float) -> None:
    content = encode_splats(layout, some())
    path = tmp_path / f"a.{layout}"
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=f"a\\.{layout}: "):
        read_gaussian_file(path)


def test_spz_that_promises_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(HEADER.pack(b"NGSP", 3, 10**7, 3, 12, 0, 0)))
    with pytest.raises(ValueError, match="10,000,000 Gaussians take"):
        read_gaussian_file(path)
    path.write_bytes(gzip.compress(HEADER.pack(b"NGSP", 9, 1, 3, 12, 0, 0)))
    with pytest.raises(ValueError, match="version 9"):
        read_gaussian_file(path)
    path.write_bytes(gzip.compress(b"something else, and long enough"))
    with pytest.raises(ValueError, match="expected b'NGSP'"):
        read_gaussian_file(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 1}, "version 1, expected 2"),
        ({"count": 10**6}, "pixels for 1000000|pixels for 1,000,000"),
        ({"count": -1}, "promises -1"),
        ({"means": {}}, "files"),
        ({"scales": {"files": ["scales.webp"], "codebook": [0.0]}}, "out of bounds"),
    ],
)
def test_a_sog_whose_parts_do_not_fit_is_refused(tmp_path: Path, change: dict, message: str) -> None:
    zipfile.ZipFile(io.BytesIO(encode_splats("sog", some()))).extractall(tmp_path)
    meta = json.loads((tmp_path / "meta.json").read_text())
    (tmp_path / "meta.json").write_text(json.dumps(meta | change))
    with pytest.raises(ValueError, match=message):
        read_gaussian_file(tmp_path / "meta.json")


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"expected one of \.ply, \.spz, \.sog"):
        read_gaussian_file(tmp_path / "a.splat")
