"""Files that anybody may have damaged or made up: a DatasetError that names the file, in little time and memory."""

from __future__ import annotations

import copy
import io
import json
import os
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pycolmap
import pytest
from captures import OPENCV, gradient, write_capture
from damaged_files import EPS, write_npy_header, write_promising_png
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.formats.mask_file import read_mask_file
from envgs_bench.datasets.formats.normal_maps import NormalMap
from envgs_bench.datasets.formats.pictures import read_header, read_picture
from envgs_bench.datasets.formats.point_clouds import read_point_cloud

BLACK = (0.0, 0.0, 0.0)
NAMES = [f"{index}.png" for index in range(4)]
READERS: dict[str, Callable[[Path], object]] = {
    "header": read_header,
    "picture": lambda path: read_picture(path, BLACK),
    "turned": lambda path: read_picture(path, BLACK, turn=True),
    "mask": read_mask_file,
    "normals": lambda path: NormalMap(path).read(None),
    "size": lambda path: NormalMap(path).size(),
}


def refused(read: Callable[[Path], object], path: Path, message: str = "") -> None:
    with pytest.raises(DatasetError) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def damage(draw: st.DrawFn, content: bytes) -> bytes:
    """A few bytes changed, a number that reads as a count made large, the end cut off or something added."""
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(0, min(len(changed), draw(st.sampled_from([24, 100, len(content)]))) - 1)))
        how = draw(st.integers(0, 9))
        if how < 5:
            changed[at : at + 1] = draw(st.binary(min_size=1, max_size=1))
        elif how < 7:
            changed[at : at + 8] = draw(st.sampled_from([b"\xff" * 8, bytes(8), struct.pack("<Q", 10**9)]))
        elif how < 9:
            del changed[at:]
        else:
            changed += draw(st.binary(max_size=40))
    return bytes(changed)


# Pictures


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("write", "message"),
    [
        (write_promising_png, "exceeds limit"),
        (lambda path: path.write_bytes(EPS), "cannot identify image file"),
        (os.mkfifo, "it is a named pipe, expected a file"),
        (Path.mkdir, "it is a folder, expected a file"),
        (lambda path: path.symlink_to("/dev/zero"), "it is a device, expected a file"),
        (lambda path: path.symlink_to(path), ""),
    ],
)
def test_what_is_no_picture(tmp_path: Path, reader: str, write: Callable[[Path], object], message: str) -> None:
    write(tmp_path / "a.png")
    refused(READERS[reader], tmp_path / "a.png", message)


def test_no_program_is_started_for_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pillow asks Ghostscript to draw EPS."""
    monkeypatch.setattr(subprocess, "check_call", lambda *_, **__: pytest.fail("started a program"))
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("started a program"))
    (tmp_path / "a.png").write_bytes(EPS)
    refused(READERS["picture"], tmp_path / "a.png")


def test_a_phones_photograph_of_several_pictures_is_read(tmp_path: Path) -> None:
    """JPEG that Pillow knows as MPO, as some phones write it."""
    first, second = Image.fromarray(gradient()), Image.fromarray(gradient())
    first.save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=[second], quality=100)
    assert np.abs(read_picture(tmp_path / "a.jpg", BLACK)[0].astype(int) - gradient()).max() < 16


def pictures() -> list[bytes]:
    image = Image.fromarray(gradient())
    sixteen = Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) * 257)
    found = []
    for picture, form, options in [
        (image, "PNG", {}),
        (image.convert("P"), "PNG", {}),
        (sixteen, "PNG", {}),
        (image.convert("RGBA"), "PNG", {}),
        (image, "JPEG", {}),
        (image, "WEBP", {}),
        (image, "BMP", {}),
        (image, "TIFF", {}),
        (image, "PPM", {}),
    ]:
        stream = io.BytesIO()
        picture.save(stream, form, **options)
        found.append(stream.getvalue())
    return found


@settings(max_examples=150, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_pictures_are_read_or_refused(data: st.DataObject) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.png"
        path.write_bytes(damage(data.draw, data.draw(st.sampled_from(PICTURES))))
        for read in READERS.values():
            try:
                read(path)
            except DatasetError as error:
                named = str(path) in str(error)
                assert named


PICTURES = pictures()


# Arrays


@pytest.mark.filterwarnings("ignore:overflow encountered")  # in NumPy's own product of the lengths
@pytest.mark.parametrize(
    ("shape", "dtype", "values"),
    [
        ("(-4, 5, 3)", "<f4", 240),
        ("(-4, -5, 3)", "<f4", 240),
        ("(1000000, 1000000, 3)", "<f4", 240),
        ("(4294967296, 4294967296, 3)", "<f4", 240),
        ("(4, 5, 3)", "<f4", 239),
        ("(4, 5, 3)", "|O", 240),
        ("(4, 5, 3)", "<i4", 240),
        ("(4, 5, 2)", "<f4", 240),
        ("4", "<f4", 240),
        ("__import__('os').mkdir('made')", "<f4", 240),
        ("(" * 3000, "<f4", 240),
    ],
)
def test_arrays_that_are_no_normals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shape: str, dtype: str, values: int
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_npy_header(tmp_path / "a.npy", shape, dtype, bytes(values))
    for reader in ("size", "normals"):
        refused(READERS[reader], path)
    assert not (tmp_path / "made").exists()


def test_an_archive_of_arrays_or_a_pipe_is_no_array(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", normals=np.ones((4, 5, 3), np.float32))
    (tmp_path / "a.npz").rename(tmp_path / "a.npy")
    os.mkfifo(tmp_path / "b.npy")
    for name in ("a.npy", "b.npy"):
        for reader in ("size", "normals"):
            refused(READERS[reader], tmp_path / name, "cannot be read as an array")


def test_an_array_that_no_float32_holds_is_unknown_there(tmp_path: Path) -> None:
    values = np.zeros((2, 2, 3))
    values[..., 2] = 1
    values[0, 0] = 1e300
    np.save(tmp_path / "a.npy", values)
    normals = NormalMap(tmp_path / "a.npy").read(None)
    assert normals[0, 0].tolist() == [0, 0, 0]
    assert normals[1, 1].tolist() == [0, 0, 1]


# Point clouds


def write_ply(path: Path, count: str, properties: str, body: bytes, form: str = "binary_little_endian") -> Path:
    path.write_bytes(f"ply\nformat {form} 1.0\nelement vertex {count}\n{properties}end_header\n".encode() + body)
    return path


FLOATS = "".join(f"property float {axis}\n" for axis in "xyz")
LISTS = "".join(f"property list uchar float {axis}\n" for axis in "xyz")
BYTES = "".join(f"property uchar {channel}\n" for channel in ("red", "green", "blue"))


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    ("count", "properties", "message"),
    [
        (10**9, FLOATS, "promises 1000000000 rows of vertex, the file has"),
        (2**70, FLOATS, "rows of vertex, the file has"),
        (-1, FLOATS, "promises -1 rows"),
        (10**9, LISTS, "promises 1000000000 rows"),
        ("9" * 5000, FLOATS, "cannot be read as a point cloud"),
        (1, LISTS, "its vertices have , expected x, y, z"),
        (1, "", "does not say what a row of vertex holds"),
        (1, "property list uint uint x\nproperty float y\n", ""),
        (4, "property float x\n" * 3, "cannot be read as a point cloud"),
    ],
)
def test_point_clouds_that_are_none(tmp_path: Path, form: str, count: object, properties: str, message: str) -> None:
    body = b"1 1 1 2 1 3\n" if form == "ascii" else bytes([1, 0, 0, 128, 63] * 3)
    refused(read_point_cloud, write_ply(tmp_path / "a.ply", str(count), properties, body, form), message)


def test_a_pipe_or_colors_that_are_none_are_no_point_cloud(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.ply")
    refused(read_point_cloud, tmp_path / "a.ply", "it is a named pipe")
    colors = FLOATS + BYTES.replace("uchar", "float")
    body = struct.pack("<6f", 1, 2, 3, 0.5, float("nan"), 0.5)
    refused(read_point_cloud, write_ply(tmp_path / "b.ply", "1", colors, body), "1 of 1 points have colors outside")


@settings(max_examples=200, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_point_clouds_are_read_or_refused(data: st.DataObject) -> None:
    form = data.draw(st.sampled_from(["ascii", "binary_little_endian"]))
    body = b"1 2 3 4 5 6\n" * 5 if form == "ascii" else bytes(range(75))
    with TemporaryDirectory() as folder:
        path = write_ply(Path(folder) / "a.ply", "5", FLOATS + BYTES, body, form)
        path.write_bytes(damage(data.draw, path.read_bytes()))
        try:
            assert len(read_point_cloud(path).points)
        except DatasetError as error:
            named = str(path) in str(error)
            assert named


# transforms.json


def moved(index: int) -> list[list[float]]:
    """A pose a step to the right of the one before."""
    pose = np.eye(4)
    pose[0, 3] = 0.1 * index
    return pose.tolist()


CONTENT: dict[str, Any] = {
    **{"w": 64, "h": 48, "fl_x": 60.0, "fl_y": 61.0, "cx": 31.0, "cy": 23.0, "k1": 0.01, "k2": 0.0, "p1": 0.0},
    **{"camera_model": "OPENCV", "aabb_scale": 4, "scale": 0.3, "offset": [0.5, 0.5, 0.5]},
    "frames": [
        {"file_path": f"images/{name}", "transform_matrix": moved(index), "sharpness": 3.0}
        for index, name in enumerate(NAMES)
    ],
}


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    (tmp_path / "data/images").mkdir(parents=True)
    for name in NAMES:
        Image.fromarray(gradient()).save(tmp_path / "data/images" / name)
    return tmp_path / "data"


def load_frames(root: Path, content: dict[str, Any]) -> None:
    (root / "transforms.json").write_text(json.dumps(content))
    load_scene({"kind": "transforms", "root": str(root), "random_points": 10}, root.parent / "cache")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"w": 0}, "w=0, expected a number from 1 to 100,000"),
        ({"w": -5}, "w=-5, expected a number from 1"),
        ({"h": 1e308}, "h=1e+308, expected a finite number"),
        ({"h": 200_000}, "h=200000, expected a number from 1 to 100,000"),
        ({"w": 10**400}, "w=1000000"),
        ({"w": 1e-300}, "w=1e-300, expected a number from 1"),
        ({"w": [64]}, "w=[64], expected a finite number"),
        ({"fl_x": None, "camera_angle_x": 0}, "camera_angle_x=0, expected radians between 0 and π"),
        ({"fl_x": None, "camera_angle_x": 3.2}, "camera_angle_x=3.2, expected radians"),
        ({"fl_x": None, "camera_angle_x": -1}, "camera_angle_x=-1, expected radians"),
        ({"fl_x": 1e308}, "fl_x=1e+308, expected a finite number"),
        ({"camera_model": ["OPENCV"]}, "camera_model=['OPENCV'] is not supported"),
        ({"camera_model": "x" * 5000}, "camera_model='xxx"),
        ({"aabb_scale": -1}, "aabb_scale=-1, expected a number from 1e-06"),
        ({"offset": 5}, "offset='5', expected three numbers"),
        ({"offset": [0, "a", 0]}, "offset='a', expected a finite number"),
        ({"scale": True}, "scale=True, expected a finite number"),
        ({"ply_file_path": "p" * 5000}, "of 5000 characters, which no file is called"),
        ({"ply_file_path": {"a": 1}}, "a point cloud"),
        ({"frames": [{"file_path": "x" * 5000}]}, "of 5000 characters, which no file is called"),
        ({"frames": [{"file_path": "a" * 250}]}, "of 250 characters, which no file is called"),
        ({"frames": [{"file_path": "a\0b"}]}, "which no file is called"),
        (
            {"frames": [{"file_path": f"images/{NAMES[0]}", "transform_matrix": [[1e308] * 4] * 4}]},
            "no camera-to-world",
        ),
        ({"frames": [{"file_path": f"images/{NAMES[0]}", "transform_matrix": [[10**400] * 4] * 4}]}, "no camera-to"),
    ],
)
def test_frames_that_cannot_be_used_are_named(frames: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(DatasetError) as caught:
        load_frames(frames, {key: value for key, value in (CONTENT | changes).items() if value is not None})
    assert str(frames) in str(caught.value)
    assert message in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("content", ["[" * 50_000, '{"frames": [{"w": ' + "9" * 5000 + "}]}", "\xff"])
def test_json_without_end_is_named(frames: Path, content: str) -> None:
    (frames / "transforms.json").write_text(content, encoding="latin1")
    with pytest.raises(DatasetError, match=r"transforms\.json: cannot be read as JSON"):
        load_scene({"kind": "transforms", "root": str(frames)}, frames.parent / "cache")


def test_frames_in_a_pipe_are_not_waited_for(frames: Path) -> None:
    os.mkfifo(frames / "transforms.json")
    with pytest.raises(DatasetError, match=r"transforms\.json: cannot be read as JSON \(it is a named pipe"):
        load_scene({"kind": "transforms", "root": str(frames)}, frames.parent / "cache")


def test_a_name_is_no_pattern(tmp_path: Path) -> None:
    """Normals beside a blender scene's pictures are looked for by the pictures' names."""
    for split in ("train", "test"):
        (tmp_path / f"data/{split}").mkdir(parents=True)
        for name in ("**", "[a*"):
            Image.fromarray(gradient()).save(tmp_path / f"data/{split}/{name}.png")
        listed = [{"file_path": f"{split}/{name}", "transform_matrix": moved(len(name))} for name in ("**", "[a*")]
        content = {"camera_angle_x": 0.7, "frames": listed}
        (tmp_path / f"data/transforms_{split}.json").write_text(json.dumps(content))
    scene = load_scene({"kind": "blender", "root": str(tmp_path / "data"), "random_points": 10}, tmp_path / "cache")
    assert [view.name for view in scene.test] == ["test_**", "test_[a*"]


NUMBERS = [0, -1, 5, 3.2, 1e308, 1e15, 1e-300, 10**30, 10**400]
TEXTS = ["x" * 5000, "../a", "", "[**", "/etc/passwd", "OPENCV_FISHEYE"]
ODD = st.sampled_from([None, True, [], {}, [1], {"a": 1}, [None] * 3, ["1"] * 3, *NUMBERS, *TEXTS])
MORE = ("camera_angle_x", "camera_angle_y", "ply_file_path", "k3", "k4", "is_fisheye", "mask_path", "w", "offset")


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_frames_are_read_or_refused(data: st.DataObject) -> None:
    content = copy.deepcopy(CONTENT)
    for _ in range(data.draw(st.integers(1, 3))):
        node = data.draw(st.sampled_from([content, content, content["frames"][0]]))
        node[data.draw(st.sampled_from([*node, *MORE]))] = data.draw(ODD)
        if not isinstance(content["frames"], list) or not content["frames"]:
            break
    with TemporaryDirectory() as folder:
        root = Path(folder) / "data"
        (root / "images").mkdir(parents=True)
        for name in NAMES:
            Image.fromarray(gradient(16, 12)).save(root / "images" / name)
        try:
            load_frames(root, content)
        except DatasetError as error:
            assert root.name in str(error) or any(name in str(error) for name in NAMES)  # noqa: PT017


# COLMAP


def capture(root: Path, form: str) -> Path:
    """A capture of four images that see thirty points, with its model in the given form."""
    places = np.random.default_rng(0).random((30, 2)) * 40
    write_capture(root, NAMES, camera=OPENCV, seen_at=places)
    model = pycolmap.Reconstruction(str(root / "sparse/0"))
    shutil.rmtree(root / "sparse/0")
    (root / "sparse/0").mkdir()
    if form == "binary":
        model.write_binary(str(root / "sparse/0"))
    else:
        model.write_text(str(root / "sparse/0"))
    return root


def load_capture(root: Path) -> None:
    load_scene({"kind": "colmap", "root": str(root)}, root.parent / "cache")


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"])
@pytest.mark.parametrize("left", [0, 7, 8, 20, -40, -8, -1, "more", "many"])
def test_a_binary_file_of_another_length_than_it_says(tmp_path: Path, name: str, left: int | str) -> None:
    root = capture(tmp_path / "data", "binary")
    path = root / "sparse/0" / name
    content = path.read_bytes()
    if isinstance(left, int):
        if left and -left >= len(content) - 8:
            pytest.skip("that leaves nothing of so short a file")
        content = content[:left]
    else:
        content = content + bytes(5) if left == "more" else struct.pack("<Q", 10**12) + content[8:]
    path.write_bytes(content)
    start = time.perf_counter()
    with pytest.raises(DatasetError) as caught:
        load_capture(root)
    assert time.perf_counter() - start < 5
    assert f"{path.parent}: cannot be read as a COLMAP model ({name} " in str(caught.value)


def test_lengths_of_whole_models_are_as_they_say(tmp_path: Path) -> None:
    """Cameras of every model, an image without points, and a rig of two cameras with a pose between them."""
    root = capture(tmp_path / "data", "text")
    names = [name for name in pycolmap.CameraModelId.__members__ if name != "INVALID"]
    lines = []
    for number, name in enumerate(names, start=2):
        camera = pycolmap.Camera.create_from_model_name(number, name, 60.0, 64, 48)
        lines.append(f"{number} {name} 64 48 {' '.join(map(str, camera.params))}\n")
    with (root / "sparse/0/cameras.txt").open("a") as stream:
        stream.writelines(lines)
    with (root / "sparse/0/rigs.txt").open("a") as stream:
        stream.write("9 3 CAMERA 2 CAMERA 3 1 1 0 0 0 0.5 0 0 CAMERA 4 0\n")
    model = pycolmap.Reconstruction(str(root / "sparse/0"))
    assert len(model.cameras) == 1 + len(names)
    assert len(model.rigs) == 2
    shutil.rmtree(root / "sparse/0")
    (root / "sparse/0").mkdir()
    model.write_binary(str(root / "sparse/0"))
    load_capture(root)


@pytest.mark.parametrize("form", ["text", "binary"])
def test_a_camera_without_pixels(tmp_path: Path, form: str) -> None:
    root = capture(tmp_path / "data", "text")
    path = root / "sparse/0/cameras.txt"
    path.write_text(path.read_text().replace("OPENCV 64 48", "OPENCV 0 48"))
    if form == "binary":
        pycolmap.Reconstruction(str(path.parent)).write_binary(str(path.parent))
    with pytest.raises(DatasetError, match=r"sparse/0: camera 1 of image 0\.png is 0×48 pixels, expected 1 to 100,000"):
        load_capture(root)


@pytest.mark.parametrize("form", ["text", "binary"])
def test_a_model_in_a_pipe_is_not_waited_for(tmp_path: Path, form: str) -> None:
    root = capture(tmp_path / "data", form)
    (path,) = (root / "sparse/0").glob("points3D.*")
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(DatasetError, match=r"sparse/0: cannot be read as a COLMAP model .*named pipe"):
        load_capture(root)


@pytest.mark.parametrize("form", ["text", "binary"])
def test_an_image_whose_name_is_no_text(tmp_path: Path, form: str) -> None:
    root = capture(tmp_path / "data", form)
    (path,) = (root / "sparse/0").glob("images.*")
    path.write_bytes(path.read_bytes().replace(b"1.png", b"\xff.png"))
    with pytest.raises(DatasetError, match="sparse/0: cannot be read as a COLMAP model"):
        load_capture(root)


WORDS = ["0", "-1", "1e308", "nan", "x", "", "99999999999999999999", "4294967295", "1e-320", "../a", "PINHOLE", "#"]


@settings(max_examples=100, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_models_are_read_or_refused(data: st.DataObject) -> None:
    form = data.draw(st.sampled_from(["text", "binary"]))
    with TemporaryDirectory() as folder:
        root = capture(Path(folder) / "data", form)
        path = data.draw(st.sampled_from(sorted((root / "sparse/0").iterdir())))
        if form == "binary":
            path.write_bytes(damage(data.draw, path.read_bytes()))
        else:
            lines = [line.split(" ") for line in path.read_text().splitlines() if not line.startswith("#")]
            line = data.draw(st.sampled_from(lines))
            line[data.draw(st.integers(0, min(len(line) - 1, 12)))] = data.draw(st.sampled_from(WORDS))
            path.write_text("\n".join(" ".join(line) for line in lines) + "\n")
        try:
            load_capture(root)
        except DatasetError as error:
            assert "data/" in str(error) or any(name in str(error) for name in NAMES)  # noqa: PT017


# All of them, by what they cost

PROMISES = """
import resource, sys, time
from pathlib import Path
from envgs_bench.datasets import DatasetError
from envgs_bench.datasets.formats.colmap_model import Model
from envgs_bench.datasets.formats.normal_maps import NormalMap
from envgs_bench.datasets.formats.mask_file import read_mask_file
from envgs_bench.datasets.formats.pictures import read_picture
from envgs_bench.datasets.formats.point_clouds import read_point_cloud
from envgs_bench.methods.storage.ply import read_ply

folder = Path(sys.argv[1])
before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
for read, name in [
    (lambda path: read_picture(path, (0, 0, 0)), "a.png"),
    (lambda path: NormalMap(path).read(None), "a.npy"),
    (read_point_cloud, "a.ply"),
    (read_point_cloud, "lists.ply"),
    (read_ply, "a.ply"),
    (lambda path: Model(path).content, "model"),
]:
    try:
        read(folder / name)
    except ValueError as error:
        assert name in str(error)
    else:
        raise SystemExit(f"{name} was read")
grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
print(grown // 1024, time.perf_counter() - start)
"""


def test_files_that_promise_gigabytes_cost_neither_time_nor_memory(tmp_path: Path) -> None:
    write_promising_png(tmp_path / "a.png")
    write_npy_header(tmp_path / "a.npy", "(100000, 100000, 3)", values=bytes(1000))
    write_ply(tmp_path / "a.ply", str(10**9), FLOATS, bytes(1000))
    write_ply(tmp_path / "lists.ply", str(10**9), LISTS, bytes(1000))
    (capture(tmp_path / "data", "binary") / "sparse/0").rename(tmp_path / "model")
    content = (tmp_path / "model/points3D.bin").read_bytes()
    (tmp_path / "model/points3D.bin").write_bytes(struct.pack("<Q", 2**40) + content[8:])
    command = [sys.executable, "-c", PROMISES, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    megabytes, seconds = map(float, done.stdout.split())
    assert megabytes < 100
    assert seconds < 20
