"""PLY: against the layout read byte by byte, files that another program wrote, and renders to the last bit."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement
from torch import Tensor

from envgs_bench.core import Camera, rasterize
from envgs_bench.methods.gaussians.parameters import GaussianParameters, LearningRates
from envgs_bench.methods.storage.ply import read_gaussians, read_ply, write_ply

real = pytest.mark.skipif(
    "ENVGS_BENCH_DATA" not in os.environ, reason="ENVGS_BENCH_DATA names no folder of real captures"
)

HEADER_3DGS = (
    [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    + [f"f_rest_{i}" for i in range(45)]
    + ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
)


def tensors_of(count: int = 50, axes: int = 2, degree: int = 2, beta: bool = True) -> dict[str, Tensor]:
    random = torch.Generator().manual_seed(count + axes + degree)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=random)

    tensors = {
        "means": normal(count, 3) + torch.tensor([0.0, 0, 4]),
        "quaternions": normal(count, 4),
        "log_scales": normal(count, axes) * 0.3 - 2,
        "opacity_logits": normal(count),
        "sh_dc": normal(count, 1, 3),
        "sh_rest": normal(count, (degree + 1) ** 2 - 1, 3) / 4,
    }
    return tensors | ({"beta_logits": normal(count, 1)} if beta else {})


def plain_rows(path: Path) -> tuple[list[str], np.ndarray]:
    """Names and values of a binary PLY of float32, by hand."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    (count,) = (int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    return names, np.frombuffer(body, "<f4").reshape(count, len(names))


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("beta", [False, True])
def test_what_is_read_is_what_was_written(tmp_path: Path, axes: int, degree: int, beta: bool) -> None:
    tensors = tensors_of(axes=axes, degree=degree, beta=beta)
    write_ply(tmp_path / "set.ply", tensors)
    read = read_ply(tmp_path / "set.ply")
    assert list(read) == list(tensors)
    for name, values in tensors.items():
        assert torch.equal(read[name], values), name
        assert read[name].is_contiguous()


def test_the_layout_is_that_of_3dgs_and_each_value_lies_where_its_name_says(tmp_path: Path) -> None:
    tensors = tensors_of(axes=3, degree=3, beta=False)
    write_ply(tmp_path / "set.ply", tensors)
    names, rows = plain_rows(tmp_path / "set.ply")
    assert names == HEADER_3DGS
    column = dict(zip(names, rows.T, strict=True))
    assert np.array_equal(column["y"], tensors["means"][:, 1])
    assert np.array_equal(column["opacity"], tensors["opacity_logits"])
    assert np.array_equal(column["scale_2"], tensors["log_scales"][:, 2])
    assert np.array_equal(column["rot_0"], tensors["quaternions"][:, 0])
    assert np.array_equal(column["f_dc_1"], tensors["sh_dc"][:, 0, 1])
    assert np.array_equal(column["f_rest_3"], tensors["sh_rest"][:, 3, 0])  # red's fourth
    assert np.array_equal(column["f_rest_15"], tensors["sh_rest"][:, 0, 1])  # green's first
    assert np.array_equal(column["f_rest_44"], tensors["sh_rest"][:, 14, 2])  # blue's last
    assert not column["nz"].any()


def test_a_surfel_has_two_scales_and_beta_comes_last(tmp_path: Path) -> None:
    write_ply(tmp_path / "set.ply", tensors_of(), two_scales=True)
    names, _ = plain_rows(tmp_path / "set.ply")
    assert [name for name in names if name.startswith("scale")] == ["scale_0", "scale_1"]
    assert names[-1] == "beta"


def test_viewers_get_surfels_with_a_third_scale_in_the_layout_of_3dgs(tmp_path: Path) -> None:
    write_ply(tmp_path / "set.ply", tensors_of(degree=3, beta=False))
    names, rows = plain_rows(tmp_path / "set.ply")
    assert names == HEADER_3DGS
    assert np.array_equal(rows[:, names.index("scale_2")], np.full(50, np.log(1e-6), np.float32))


def test_surfels_come_back_from_two_scales_and_from_three(tmp_path: Path) -> None:
    tensors = tensors_of()
    for two_scales in (True, False):
        write_ply(tmp_path / "set.ply", tensors, two_scales)
        assert all(torch.equal(values, tensors[name]) for name, values in read_ply(tmp_path / "set.ply").items())
        assert read_gaussians(tmp_path / "set.ply").is_surfels


def test_one_gaussian_that_is_thicker_makes_a_set_of_3d_gaussians(tmp_path: Path) -> None:
    write_ply(tmp_path / "set.ply", tensors_of())
    rewritten(tmp_path / "set.ply", change=("scale_2", -13.0))
    read = read_ply(tmp_path / "set.ply")["log_scales"]
    assert read.shape == (50, 3)
    assert read[3, 2] == -13


def test_a_set_read_again_is_drawn_the_same_to_the_last_bit(tmp_path: Path) -> None:
    intrinsics = torch.tensor([[40.0, 0, 24], [0, 40, 16], [0, 0, 1]])
    camera = Camera(torch.eye(4), intrinsics, width=48, height=32)
    for axes in (2, 3):
        tensors = tensors_of(axes=axes)
        write_ply(tmp_path / "set.ply", tensors)
        before = GaussianParameters(tensors, LearningRates(), 1.0).gaussians().map(Tensor.detach)
        first, second = (rasterize(gaussians, camera) for gaussians in (before, read_gaussians(tmp_path / "set.ply")))
        assert first.alpha.max() > 0.5
        assert torch.equal(first.color, second.color)
        assert torch.equal(first.extras, second.extras)


def test_an_empty_set_survives(tmp_path: Path) -> None:
    write_ply(tmp_path / "set.ply", tensors_of(count=0))
    assert {name: tuple(value.shape) for name, value in read_ply(tmp_path / "set.ply").items()} == {
        "means": (0, 3),
        "quaternions": (0, 4),
        "log_scales": (0, 2),
        "opacity_logits": (0,),
        "sh_dc": (0, 1, 3),
        "sh_rest": (0, 8, 3),
        "beta_logits": (0, 1),
    }


def test_ascii_doubles_and_further_properties_are_read(tmp_path: Path) -> None:
    tensors = tensors_of(beta=False)
    write_ply(tmp_path / "set.ply", tensors)
    table = PlyData.read(tmp_path / "set.ply")["vertex"].data
    wide = np.empty(len(table), [("id", "u1"), *((name, "f8") for name in table.dtype.names)])
    for name in table.dtype.names:
        wide[name] = table[name]
    PlyData([PlyElement.describe(wide, "vertex")], text=True).write(tmp_path / "wide.ply")
    read = read_ply(tmp_path / "wide.ply")
    assert all(torch.equal(read[name], tensors[name]) for name in tensors)


def rewritten(path: Path, keep: str | None = None, change: tuple[str, float] | None = None) -> None:
    table = PlyData.read(path)["vertex"].data
    if keep is not None:
        table = table[[name for name in table.dtype.names if not name.startswith(keep)]]
    if change is not None:
        table = table.copy()
        table[change[0]][3] = change[1]
    PlyData(
        [PlyElement.describe(np.array(table.tolist(), dtype=[(n, "f4") for n in table.dtype.names]), "vertex")]
    ).write(path)


@pytest.mark.parametrize(
    ("drop", "message"),
    [
        ("opacity", r"has no property opacity; a set of Gaussians needs x, y, z, f_dc_0.*It has x, y, z, nx"),
        ("scale_", r"has no property scale_0, scale_1;"),
        ("rot_2", r"has no property rot_2;"),
        ("f_rest_1", r"has 13 properties f_rest_…, expected f_rest_0 and on, 0, 9, 24, 45 in all"),
        ("f_dc_", r"has no property f_dc_0, f_dc_1, f_dc_2;"),
    ],
)
def test_missing_properties_are_named(tmp_path: Path, drop: str, message: str) -> None:
    write_ply(tmp_path / "set.ply", tensors_of())
    rewritten(tmp_path / "set.ply", keep=drop)
    with pytest.raises(ValueError, match=rf"set\.ply: {message}"):
        read_ply(tmp_path / "set.ply")


def test_values_that_no_gaussian_has_are_counted(tmp_path: Path) -> None:
    for name, message in (("y", "1 of 50 Gaussians have means"), ("opacity", "1 of 50 Gaussians have opacity_logits")):
        write_ply(tmp_path / "set.ply", tensors_of())
        rewritten(tmp_path / "set.ply", change=(name, np.nan))
        with pytest.raises(ValueError, match=message):
            read_ply(tmp_path / "set.ply")
    tensors = tensors_of()
    tensors["quaternions"][7] = 0
    write_ply(tmp_path / "set.ply", tensors)
    with pytest.raises(ValueError, match="1 Gaussians have a rotation of four zeros"):
        read_ply(tmp_path / "set.ply")


def test_files_that_are_no_ply_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.ply: cannot be read \(No such file"):
        read_ply(tmp_path / "none.ply")
    (tmp_path / "text.ply").write_text("hello")
    with pytest.raises(ValueError, match=r"text\.ply: is no readable PLY"):
        read_ply(tmp_path / "text.ply")
    write_ply(tmp_path / "cut.ply", tensors_of())
    (tmp_path / "cut.ply").write_bytes((tmp_path / "cut.ply").read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"cut\.ply: is no readable PLY"):
        read_ply(tmp_path / "cut.ply")
    faces = PlyElement.describe(np.zeros(2, [("a", "f4")]), "face")
    PlyData([faces]).write(tmp_path / "mesh.ply")
    with pytest.raises(ValueError, match="has no element vertex, only face"):
        read_ply(tmp_path / "mesh.ply")


@real
def test_a_set_that_another_program_wrote_is_read_and_written_back_unchanged(tmp_path: Path) -> None:
    path = Path(os.environ["ENVGS_BENCH_DATA"]) / "splats" / "plush_dog_3dgs_sh3.ply"
    tensors = read_ply(path)
    assert tensors["means"].shape == (15105, 3)
    assert tensors["sh_rest"].shape == (15105, 15, 3)
    assert tensors["opacity_logits"].max() == 400
    gaussians = read_gaussians(path)
    assert gaussians.opacities.max() == 1
    assert not gaussians.is_surfels
    write_ply(tmp_path / "again.ply", tensors)
    theirs, ours = (PlyData.read(file)["vertex"].data for file in (path, tmp_path / "again.ply"))
    assert ours.dtype.names == theirs.dtype.names
    for name in theirs.dtype.names:
        if name not in ("nx", "ny", "nz"):
            assert np.array_equal(theirs[name], ours[name]), name


@real
def test_a_compressed_set_is_refused() -> None:
    path = Path(os.environ["ENVGS_BENCH_DATA"]) / "splats" / "plush_dog_3dgs.compressed.ply"
    with pytest.raises(ValueError, match=r"compressed layout of splats.*export it as an uncompressed PLY"):
        read_ply(path)
