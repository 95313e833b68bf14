"""Stored models: each field within its bounds, files that anybody can read, and damaged ones that are named."""

from __future__ import annotations

import io
import json
import os
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from plyfile import PlyData
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from envgs_bench.core import Camera, rasterize
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.ordering import grid_points, morton_codes
from envgs_bench.methods.gaussians.parameters import GaussianParameters, LearningRates
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage import compact
from envgs_bench.methods.storage.layouts import LAYOUTS
from envgs_bench.methods.storage.lzma_zip import zip_of
from envgs_bench.methods.storage.ply import read_ply
from envgs_bench.methods.storage.quantized_set import dequantize, quantize
from envgs_bench.methods.storage.splats import decode_splats, encode_splats
from envgs_bench.testing import tiny_scene

REST = {0: 0, 1: 3, 2: 8, 3: 15}


def tensors_of(count: int = 300, axes: int = 2, degree: int = 2, beta: bool = True) -> dict[str, Tensor]:
    random = torch.Generator().manual_seed(count + axes + degree)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=random)

    tensors = {
        "means": normal(count, 3) + torch.tensor([0.0, 0, 6]),
        "quaternions": 3 * normal(count, 4),
        "log_scales": normal(count, axes) - 2,
        "opacity_logits": 4 * normal(count),
        "sh_dc": normal(count, 1, 3),
        "sh_rest": normal(count, REST[degree], 3) / 5,
    }
    return tensors | ({"beta_logits": 6 * normal(count, 1)} if beta else {})


STATE = {"sets": {"base": tensors_of(60)}, "background": torch.zeros(3), "near": 0.2}
CONTENT = compact.encode("EnvGS", STATE)


def nearest(ours: Tensor, theirs: Tensor) -> tuple[Tensor, np.ndarray]:
    """Which of the points `theirs` each of `ours` is, and how far off; each is taken once."""
    distance, index = cKDTree(theirs.numpy()).query(ours.numpy())
    assert len(set(index)) == len(ours) == len(theirs)
    return torch.from_numpy(index), distance


def degrees_apart(ours: Tensor, theirs: Tensor) -> np.ndarray:
    first, second = (Rotation.from_quat(q.double().numpy(), scalar_first=True) for q in (ours, theirs))
    return np.degrees((first * second.inv()).magnitude())


def test_places_on_the_curve_are_the_coordinates_bits_in_turn() -> None:
    grid = np.random.default_rng(0).integers(0, 1 << 21, (200, 3))
    grid[0], grid[1] = 0, (1 << 21) - 1
    bits = [[f"{value:021b}" for value in point[::-1]] for point in grid]
    expected = [int("".join(z + y + x for z, y, x in zip(*point, strict=True)), 2) for point in bits]
    assert morton_codes(grid).tolist() == expected
    assert np.array_equal(grid_points(morton_codes(grid)), grid)


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize(("degree", "beta"), [(0, False), (2, True), (3, False)])
def test_every_field_comes_back_within_half_a_step(axes: int, degree: int, beta: bool) -> None:
    tensors = tensors_of(axes=axes, degree=degree, beta=beta)
    read = dequantize(*quantize(tensors))
    assert {name: (v.shape, v.dtype) for name, v in read.items()} == {n: (v.shape, v.dtype) for n, v in tensors.items()}
    rows, distance = nearest(read["means"], tensors["means"])
    smallest = float(np.median(tensors["log_scales"].exp().amin(1).numpy()))
    assert 0.02 * smallest < distance.max() <= 0.0868 * smallest  # half of a tenth along all three axes
    kept = {name: values[rows] for name, values in tensors.items()}
    for name, most in (("log_scales", 1 / 40), ("sh_dc", 1 / 32), ("sh_rest", 1 / 32)):
        if kept[name].numel():
            assert most / 2 < (read[name] - kept[name]).abs().max() <= most + 1e-6, name
    assert degrees_apart(read["quaternions"], kept["quaternions"]).max() < 0.7
    for name in ("opacity_logits", "beta_logits") if beta else ("opacity_logits",):
        off = (read[name].double().sigmoid() - kept[name].double().sigmoid()).abs()
        assert 0.2 / 255 < off.max() <= 0.5001 / 255, name
        assert read[name].abs().max() < 7  # no level is an infinite logit


@pytest.mark.parametrize("count", [0, 1])
def test_sets_of_none_and_of_one_survive(count: int) -> None:
    tensors = tensors_of(count)
    read = dequantize(*quantize(tensors))
    assert {name: value.shape for name, value in read.items()} == {name: v.shape for name, v in tensors.items()}
    assert torch.allclose(read["means"], tensors["means"])


def test_gaussians_that_are_all_the_same_and_far_apart_ones_survive() -> None:
    same = {name: value[:1].expand(40, *value.shape[1:]) for name, value in tensors_of().items()}
    assert dequantize(*quantize(same))["means"].unique(dim=0).shape == (1, 3)
    far = tensors_of()
    far["means"][0] = torch.tensor([1e7, 0, 0])  # the grid cannot be as fine as the primitives ask for
    read = dequantize(*quantize(far))
    assert (read["means"].amax(0) - far["means"].amax(0)).abs().max() < 1e7 / 2**21


def test_a_field_that_is_not_known_is_kept_as_it_is() -> None:
    tensors = tensors_of(beta=False) | {"roughness": torch.rand(300, 2)}
    read = dequantize(*quantize(tensors))
    rows, _ = nearest(read["means"], tensors["means"])
    assert torch.equal(read["roughness"], tensors["roughness"][rows])


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    tensors = tensors_of()
    tensors["sh_rest"][3, 1, 1] = value
    with pytest.raises(ValueError, match="sh_rest are not all finite"):
        quantize(tensors)
    with pytest.raises(ValueError, match="log_scales reach 1e"):
        quantize(tensors_of() | {"log_scales": torch.full((300, 2), 1e30)})


@pytest.fixture(scope="module")
def trained() -> dict[str, GaussianMethod]:
    methods = {}
    for kind, own in (("envgs", {"env_grid": 3}), ("envmap", {"envmap_size": 8}), ("3dgs", {})):
        method = create_method(kind, own)
        assert isinstance(method, GaussianMethod)
        scene = tiny_scene()
        method.initialize(scene, 20)
        for step in range(1, 21):
            method.training_step(scene.train[step % len(scene.train)], step)
        methods[kind] = method
    return methods


def decibels(method: GaussianMethod) -> float:
    scene = tiny_scene()
    errors = [(method.render(v.camera).color - v.rgb()).square().mean() for v in (*scene.test, *scene.train)]
    return float(np.mean([-10 * np.log10(float(error)) for error in errors]))


@pytest.mark.parametrize("kind", ["envgs", "envmap", "3dgs"])
def test_a_model_is_opened_from_its_compact_file_alone(
    trained: dict[str, GaussianMethod], tmp_path: Path, kind: str
) -> None:
    method = trained[kind]
    (path,) = LAYOUTS["compact"].write(method, tmp_path)
    again = create_method(kind, dict.fromkeys(["envmap_size"], 8) if kind == "envmap" else {})
    assert isinstance(again, GaussianMethod)
    again.load(tmp_path)
    assert (again.primitives(), again.model_bytes()) == (method.primitives(), method.model_bytes())
    assert (again.model.near, again.model.radius) == (method.model.near, method.model.radius)
    assert torch.equal(again.model.background, method.model.background)
    assert decibels(again) > decibels(method) - 0.05
    assert 5 * path.stat().st_size < sum(method.model_bytes().values())
    with pytest.raises(ValueError, match=r"model\.npz holds a model of .*, expected one of TwoDGS"):
        create_method("2dgs", {}).load(tmp_path)


def test_the_same_model_makes_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.time", lambda: 1e9)
    assert compact.encode("EnvGS", STATE) == CONTENT


def test_a_compact_file_is_read_with_numpy_and_its_documentation_alone(tmp_path: Path) -> None:
    tensors = tensors_of()
    path = compact.write_compact(tmp_path, "EnvGS", {"sets": {"base": tensors}, "near": 0.25, "note": "text"})
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(file["header.json"])
        fields = header["state"]["sets"]["base"]["set"]["fields"]
        planes = file["sets.base.sh_rest"].astype(np.int64)
        levels = file["sets.base.beta_logits"]
    assert (header["layout"], header["method"], header["state"]["near"]) == (2, "EnvGS", 0.25)
    whole = sum(plane << (8 * n) for n, plane in enumerate(planes)) + fields["sh_rest"]["least"]
    rest = whole * fields["sh_rest"]["step"]
    state = compact.read_compact(tmp_path, "EnvGS")
    assert state["note"] == "text"
    assert np.array_equal(rest.astype(np.float32), state["sets"]["base"]["sh_rest"])
    betas = np.sort(torch.sigmoid(tensors["beta_logits"]).numpy().ravel())
    assert np.abs(np.sort(levels.ravel() / 255) - betas).max() <= 0.5001 / 255


def in_parts(monkeypatch: pytest.MonkeyPatch) -> tuple[bytes, dict[str, bytes]]:
    """A file most of whose arrays are cut into parts, and the members of the file in layout 1 that holds the same."""
    with monkeypatch.context() as patch:
        patch.setattr(compact, "PART", 700)
        content = compact.encode("EnvGS", STATE | {"matrix": torch.arange(400.0).reshape(20, 20)})
    members: dict[str, bytes] = {}
    with zipfile.ZipFile(io.BytesIO(content)) as archive, np.load(io.BytesIO(content)) as file:
        header = json.loads(archive.read("header.json"))
        described = header["state"]["sets"]["base"]["arrays"]
        shapes = {f"sets.base.{name}": shape for name, (_, *shape) in described.items()}
        for name, shape in (shapes | {"matrix": [20, 20], "background": [3]}).items():
            parts = [file[part] for part in file.files if part == name or part.startswith(f"{name}.")]
            stream = io.BytesIO()
            np.save(stream, np.concatenate([part.ravel() for part in parts]).reshape(shape))
            members[f"{name}.npy"] = stream.getvalue()
        assert {"matrix.2.npy", "sets.base.sh_rest.2.npy"} <= set(archive.namelist())
    return content, {"header.json": json.dumps(header | {"layout": 1}).encode()} | members


def test_arrays_in_parts_are_what_they_were_in_one_member(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content, members = in_parts(monkeypatch)
    new, old, plain = (tmp_path / name for name in ("new", "old", "plain"))
    for folder in (new, old):
        folder.mkdir()
    compact.write_compact(plain, "EnvGS", STATE)
    states = [compact.read_compact(written(*given), "EnvGS") for given in ((new, content), (old, archive_of(members)))]
    whole = compact.read_compact(plain, "EnvGS")["sets"]["base"]
    for state in states:
        assert torch.equal(state["matrix"], torch.arange(400.0).reshape(20, 20))
        assert all(torch.equal(state["sets"]["base"][name], value) for name, value in whole.items())


def test_a_part_that_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content, _ = in_parts(monkeypatch)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist() if name != "matrix.1.npy"}
    with pytest.raises(ValueError, match=r"matrix has 175 numbers in its parts, the header says \[20, 20\]"):
        compact.read_compact(written(tmp_path, archive_of(members)), "EnvGS")


@settings(max_examples=20, deadline=None, derandomize=True)
@given(members=st.dictionaries(st.text("ab.é", min_size=1), st.binary(max_size=3000), max_size=5))
def test_zips_are_what_pythons_library_reads(members: dict[str, bytes]) -> None:
    content = zip_of(members, 2)
    assert content == zip_of(members, 1)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        assert {name: archive.read(name) for name in archive.namelist()} == members
        assert all(info.compress_type == zipfile.ZIP_LZMA for info in archive.infolist())
        assert sum(info.compress_size for info in archive.infolist()) <= len(content)


def test_zips_are_as_small_as_pythons_librarys() -> None:
    members = {"rows": np.random.default_rng(0).binomial(8, 0.5, 60_000).astype(np.uint8).tobytes()}
    assert len(zip_of(members, 1)) < 1.005 * len(archive_of(members))


# Damaged and made-up files

EMPTY = b'{"layout": 1, "method": "EnvGS", "state": {}}'


def written(folder: Path, content: bytes) -> Path:
    (folder / compact.FILE_NAME).write_bytes(content)
    return folder


def archive_of(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_LZMA) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def changed(**header: object) -> bytes:
    """CONTENT with other things in its header."""
    with zipfile.ZipFile(io.BytesIO(CONTENT)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    return archive_of(members | {"header.json": json.dumps(json.loads(members["header.json"]) | header).encode()})


def set_of(count: object, shape: list[object]) -> dict[str, object]:
    return {"sets": {"base": {"set": {"count": count, "fields": {"sh_dc": {"shape": shape}}}, "arrays": {}}}}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "File is not a zip file"),
        (b"PK\x03\x04", "File is not a zip file"),
        (archive_of({"other": b""}), "no item named 'header.json'"),
        (archive_of({"header.json": b"{"}), "JSONDecodeError"),
        (archive_of({"header.json": b"[" * 100_000}), "RecursionError"),
        (archive_of({"header.json": b" " * 2_000_000}), "more than the 1,048,576 that it may have"),
        (archive_of({"header.json": b"{}"}), "KeyError"),
        (changed(layout=3), "its layout is 3, this version reads 1 and 2"),
        (changed(state=set_of(10**12, [1, 3])), "it promises 3,000,000,000,000 numbers, and has"),
        (changed(state=set_of(2, [-1, 3])), "expected whole numbers"),
        (changed(state=set_of("many", [1, 3])), "expected whole numbers"),
        (changed(state=set_of(2, [1, 3])), "KeyError: 'sh_dc'"),
        (changed(state={"background": {"tensor": "float64", "shape": [3]}}), "background is float32 [3], the header"),
        (changed(state={"background": {"tensor": "float32", "shape": [4]}}), "background is float32 [3], the header"),
        (archive_of({"header.json": EMPTY, "bomb": bytes(11_000_000)}), "it promises 11,000,0"),
    ],
)
def test_files_that_are_no_model_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    with pytest.raises(ValueError, match=r"model\.npz is not a readable model \(") as caught:
        compact.read_compact(written(tmp_path, content), "EnvGS")
    assert message in str(caught.value)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / compact.FILE_NAME)
    with pytest.raises(ValueError, match="it is a named pipe, expected a file"):
        compact.read_compact(tmp_path, "EnvGS")
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        create_method("envgs", {}).load(tmp_path)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_files_are_read_or_named(data: st.DataObject) -> None:
    content = bytearray(CONTENT)
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    with TemporaryDirectory() as folder:
        try:
            compact.read_compact(written(Path(folder), bytes(content)), "EnvGS")
        except ValueError as error:
            named = folder in str(error)
            assert named


# Layouts of viewers


@pytest.mark.parametrize(
    ("layout", "shift", "scale", "degrees", "rest"),
    [("spz", 4e-4, 0.04, 0.4, 0.07), ("compressed-ply", 2e-2, 0.02, 0.5, 0.02), ("sog", 2e-3, 0.1, 1.2, 0.15)],
)
@pytest.mark.parametrize(("axes", "degree"), [(2, 2), (3, 3)])
def test_a_viewers_layout_brings_back_what_it_was_given(
    layout: str, shift: float, scale: float, degrees: float, rest: float, axes: int, degree: int
) -> None:
    pytest.importorskip("gaussforge")
    tensors = tensors_of(100, axes, degree, beta=False)
    tensors["opacity_logits"][:2] = torch.tensor([40.0, -40.0])
    read = decode_splats(layout, encode_splats(layout, tensors), axes)
    rows, distance = nearest(read["means"], tensors["means"])
    kept = {name: values[rows] for name, values in tensors.items()}
    assert list(read) == list(tensors)
    assert distance.max() < shift
    assert (read["log_scales"] - kept["log_scales"]).abs().max() < scale
    assert degrees_apart(read["quaternions"], kept["quaternions"]).max() < degrees
    assert (read["opacity_logits"].sigmoid() - kept["opacity_logits"].sigmoid()).abs().max() < 0.005
    assert (read["sh_rest"] - kept["sh_rest"]).abs().max() < rest


def test_degree_0_is_read_back() -> None:
    pytest.importorskip("gaussforge")
    tensors = tensors_of(50, 3, 0, beta=False)
    assert decode_splats("spz", encode_splats("spz", tensors), 3)["sh_rest"].shape == (50, 0, 3)


def test_a_compressed_ply_holds_all_of_red_first_as_other_programs_expect() -> None:
    """Quantized to 256 levels of [−4, 4]; vertices are in the file's order."""
    pytest.importorskip("gaussforge")
    tensors = tensors_of(40, 3, 2, beta=False)
    content = encode_splats("compressed-ply", tensors)
    table = PlyData.read(io.BytesIO(content))["sh"].data
    values = (np.stack([table[f"f_rest_{n}"] for n in range(24)], 1).astype(float) + 0.5) / 256 * 8 - 4
    rows, _ = nearest(decode_splats("compressed-ply", content, 3)["means"], tensors["means"])
    expected = tensors["sh_rest"][rows].swapaxes(1, 2).reshape(40, 24).numpy()
    assert np.abs(values - expected).max() < 0.02


def test_spz_is_turned_to_right_up_back(tmp_path: Path) -> None:
    """What the file itself holds is the same picture, of a camera that is turned by as much."""
    gaussforge = pytest.importorskip("gaussforge")
    tensors = tensors_of(200, 3, 3, beta=False)
    tensors["opacity_logits"] /= 4  # none that is rounded to 0 or to 1
    plain = gaussforge.GaussForge().convert(encode_splats("spz", tensors), "spz", "ply")["data"]
    (tmp_path / "set.ply").write_bytes(plain)
    stored = read_ply(tmp_path / "set.ply")
    intrinsics = torch.tensor([[40.0, 0, 24], [0, 40, 16], [0, 0, 1]])
    cameras = [Camera(torch.diag(torch.tensor([1.0, s, s, 1])), intrinsics, 48, 32) for s in (1.0, -1.0)]
    sets = [GaussianParameters(t, LearningRates(), 1.0).gaussians().map(Tensor.detach) for t in (tensors, stored)]
    ours, theirs = (rasterize(gaussians, camera).color for gaussians, camera in zip(sets, cameras, strict=True))
    assert ours.std() > 0.1
    assert (ours - theirs).abs().mean() < 0.01


def test_what_the_library_refuses_and_its_absence_are_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("gaussforge")
    with pytest.raises(ValueError, match="gaussforge cannot convert the set to or from sog"):
        encode_splats("sog", tensors_of(0))
    monkeypatch.setitem(sys.modules, "gaussforge", None)
    with pytest.raises(ValueError, match="spz, sog, compressed-ply need the library gaussforge: pip install"):
        encode_splats("spz", tensors_of())


def test_colors_that_hardly_turn_keep_how_they_do() -> None:
    tensors = tensors_of()
    tensors["sh_rest"] /= 1_000
    read = dequantize(*quantize(tensors))
    rows, _ = nearest(read["means"], tensors["means"])
    error = (read["sh_rest"] - tensors["sh_rest"][rows]).square().mean() / tensors["sh_rest"].square().mean()
    assert 0.05 < error < 0.1  # 1/12, of steps as long as the values' root mean square


def test_what_a_layout_has_no_place_for_is_said(trained: dict[str, GaussianMethod]) -> None:
    lacks = {kind: {name: layout.lacks(method) for name, layout in LAYOUTS.items()} for kind, method in trained.items()}
    assert not any(lacks["3dgs"].values())
    assert not any(lacks[kind]["compact"] for kind in trained)
    assert (lacks["envgs"]["ply"], lacks["envgs"]["spz"]) == ([], ["β"])
    assert (lacks["envmap"]["ply"], lacks["envmap"]["sog"]) == (["texels"], ["β", "texels"])
