"""Lenses and intrinsics: random cameras show the truth to a tenth of a pixel, or an error says why they cannot."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
import torch
from captures import HEIGHT, NAMES_OF_TEN, WIDTH, gradient, write_capture
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.consistency.intrinsics import check_views
from envgs_bench.datasets.formats.photograph import Photograph
from envgs_bench.datasets.notes import collecting
from envgs_bench.datasets.photographs.fitting import fit_to_files
from envgs_bench.datasets.photographs.views import read_views

FLAT = {"fl_x": 60.0, "fl_y": 60.0, "cx": 32.0, "cy": 24.0, "w": WIDTH, "h": HEIGHT}
DISTORTIONS = {  # how many numbers follow focal lengths and principal point, and whether there are two of the former
    "SIMPLE_PINHOLE": (0, 1),
    "PINHOLE": (0, 2),
    "SIMPLE_RADIAL": (1, 1),
    "RADIAL": (2, 1),
    "OPENCV": (4, 2),
    "FULL_OPENCV": (8, 2),
    "SIMPLE_RADIAL_FISHEYE": (1, 1),
    "RADIAL_FISHEYE": (2, 1),
    "OPENCV_FISHEYE": (4, 2),
    "THIN_PRISM_FISHEYE": (8, 2),
    "SIMPLE_DIVISION": (1, 1),
}
SMALL = {"OPENCV": [1, 1, 0.1, 0.1], "FULL_OPENCV": [1, 1, 0.1, 0.1, 1, 1, 1, 1]}  # tangential: a tenth of radial
SMALL["THIN_PRISM_FISHEYE"] = [1, 1, 0.1, 0.1, 1, 1, 0.1, 0.1]


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Red says a pixel's column, green its row."""
    path = tmp_path_factory.mktemp("picture") / "000.png"
    Image.fromarray(gradient()).save(path)
    return path


def view_of(camera: pycolmap.Camera, path: Path) -> View:
    (view,) = read_views(fit_to_files([Photograph("000.png", path, camera, "1", np.eye(4))]), 1.0, (0.0, 0.0, 0.0))
    return view


@st.composite
def cameras(draw: st.DrawFn) -> pycolmap.Camera:
    model = draw(st.sampled_from(sorted(DISTORTIONS)))
    count, focals = DISTORTIONS[model]
    focal = draw(st.floats(25, 120))
    sizes = SMALL.get(model, [1.0] * count)
    numbers = [size * draw(st.floats(-0.4, 0.4)) for size in sizes]
    center = [WIDTH * draw(st.floats(0.45, 0.55)), HEIGHT * draw(st.floats(0.45, 0.55))]
    params = [focal, focal * draw(st.floats(0.97, 1.03)), *center] if focals == 2 else [focal, *center]
    return pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=[*params, *numbers])


def error_of(view: View, camera: pycolmap.Camera) -> np.ndarray:
    """Pixels between where `camera` sees a grid of points and where the view's picture, at its own projection, says."""
    own = view.camera
    x, y = np.meshgrid(np.arange(1, own.width, 3) + 0.5, np.arange(1, own.height, 3) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(own.intrinsics.double().numpy()).T
    truth = np.asarray(camera.img_from_cam(rays.reshape(-1, 3))).reshape(*x.shape, 2)
    shown = view.image.numpy()[1:-1:3, 1:-1:3, :2][: x.shape[0], : x.shape[1]] / 255 * [WIDTH, HEIGHT]
    inner = ((truth > 1) & (truth < [WIDTH - 1, HEIGHT - 1])).all(axis=-1)[: shown.shape[0], : shown.shape[1]]
    return np.abs(truth[: shown.shape[0], : shown.shape[1]] - shown)[inner]


@settings(max_examples=150, deadline=None, derandomize=True)  # the same cameras in every run
@given(camera=cameras())
def test_random_lenses_are_undistorted_rightly_or_refused(picture: Path, camera: pycolmap.Camera) -> None:
    """8 bits tell columns an eighth of a pixel apart, so that 0.1 can be asked of the median and not of each."""
    refusal = ""
    try:
        view = view_of(camera, picture)
    except DatasetError as error:
        refusal = str(error)
    if refusal:
        assert "folds back" in refusal
        return
    errors = error_of(view, camera)
    assert np.median(errors) < 0.1
    assert errors.max() < 0.3


def folds_at(k: float, focal: float) -> float:
    """Of SIMPLE_RADIAL, in pixels: r + k·r³ is largest at r = √(−1/3k)."""
    r = math.sqrt(-1 / (3 * k))
    return focal * (r + k * r**3)


@pytest.mark.parametrize("focal", [40.0, 60.0, 80.0])
@pytest.mark.parametrize("k", [-0.02, -0.1, -0.2, -0.3, -0.5, -1.0, -3.0])
def test_a_fold_is_refused_where_the_closed_form_has_one(picture: Path, focal: float, k: float) -> None:
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[focal, 32, 24, k])
    if folds_at(k, focal) > math.hypot(32, 24):
        view_of(camera, picture)
    elif folds_at(k, focal) < 32:
        with pytest.raises(DatasetError, match=rf"000\.png: .*k={k:g}\) folds back {folds_at(k, focal):.0f} pixels"):
            view_of(camera, picture)


def test_of_a_wide_fisheye_little_is_left(picture: Path) -> None:
    with collecting() as notes:
        view_of(
            pycolmap.Camera(model="OPENCV_FISHEYE", width=64, height=48, params=[12, 12, 32, 24, 0, 0, 0, 0]), picture
        )
    assert any("leaves 21 % of the photograph" in text for text in notes)


@settings(max_examples=60, deadline=None)
@given(
    factor=st.sampled_from([0.125, 0.25, 0.5, 2.0, 4.0, 8.0]),
    focal=st.floats(40, 90),
    shift=st.tuples(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03)),
)
def test_intrinsics_of_pictures_of_another_size_are_refused(
    picture: Path, factor: float, focal: float, shift: tuple[float, float]
) -> None:
    center = [factor * (32 + WIDTH * shift[0]), factor * (24 + HEIGHT * shift[1])]
    camera = pycolmap.Camera(model="PINHOLE", width=64, height=48, params=[factor * focal, factor * focal, *center])
    with pytest.raises(DatasetError, match=r"000\.png: its camera 1 .*(principal point|field of view)"):
        view_of(camera, picture)


@pytest.mark.parametrize(
    ("params", "what"),
    [
        ([0.9, 1.2, 0.5, 0.5], "neither millimeters nor shares"),  # shares of the size
        ([60, 60, 0, 0], "the first pixel's corner"),  # from the middle
        ([60, 60, 24, 32], "turned by 90°"),
        ([40000, 40000, 32, 24], "0.09.°"),
    ],
)
def test_intrinsics_of_another_unit_are_refused(picture: Path, params: list[float], what: str) -> None:
    with pytest.raises(DatasetError, match=what):
        view_of(pycolmap.Camera(model="PINHOLE", width=64, height=48, params=params), picture)


def view_with(fx: float, fy: float, cx: float, cy: float) -> View:
    k = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return View("a", Camera(torch.eye(4), k, WIDTH, HEIGHT), torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8))


@pytest.mark.parametrize(
    ("camera", "word"),
    [
        ((60, 60, 50, 20), "cx, cy"),
        ((60, 90, 32, 24), "fl_y"),
        ((13, 13, 32, 24), "more than 130°"),
        ((1500, 1500, 32, 24), "less than 3°"),
    ],
)
def test_odd_intrinsics_of_any_source_are_noted(camera: tuple[float, ...], word: str) -> None:
    with collecting() as notes:
        check_views("data", [view_with(*camera)])
    assert len(notes) == 1
    assert word in notes[0]


def test_intrinsics_of_a_plug_in_are_refused() -> None:
    with pytest.raises(DatasetError, match=r"^data: view a: .*pictures of 128×96 pixels"):
        check_views("data", [view_with(110, 110, 64, 48)])


@pytest.mark.parametrize("camera", [(60, 62, 30.5, 25), (500, 500, 30, 22), (30, 30, 36, 20)])
def test_ordinary_intrinsics_pass_silently(camera: tuple[float, ...]) -> None:
    with collecting() as notes:
        check_views("data", [view_with(*camera)])
    assert not notes


def write(root: Path, shared: dict[str, Any], **frame: Any) -> Path:
    """transforms.json beside ten pictures; `frame` is of the first one alone."""
    frames = [{"file_path": f"images/{name}", "transform_matrix": np.eye(4).tolist()} for name in NAMES_OF_TEN]
    for index, entry in enumerate(frames):
        entry["transform_matrix"][0][3] = 0.1 * index  # type: ignore[index]
    frames[0].update(frame)
    (root / "transforms.json").write_text(json.dumps({"aabb_scale": 4, "frames": frames, **shared}))
    return root


def load(root: Path, **given: Any) -> Scene:
    return load_scene({"kind": "transforms", "root": str(root), **given}, root.parent / "cache")


ANGLE = 2 * math.atan(32 / 60)
NO_SIZE = {key: value for key, value in FLAT.items() if key not in "wh"}


@pytest.mark.parametrize(
    ("shared", "frame", "message"),
    [
        (
            {**NO_SIZE, "fl_x": 120, "fl_y": 120, "cx": 64, "cy": 48},
            {},
            r"cx=64, cy=48\) far from the middle.*state w and h",
        ),
        ({**NO_SIZE, "cx": 40}, {}, "gives no w and h"),
        ({**FLAT, "h": None}, {}, "gives w and not h"),
        ({**FLAT, "cy": None}, {}, "gives cx and not cy"),
        ({**FLAT, "camera_angle_x": 1.2 * ANGLE}, {}, "fl_x=60 and camera_angle_x=1.17.* differ .*at w=64"),
        ({**FLAT, "camera_angle_y": ANGLE}, {}, "fl_y=60 and camera_angle_y=0.97.* differ"),
        (FLAT, {"fl_x": 50.0, "camera_angle_x": ANGLE}, "fl_x=50 .* differ for images/000.png"),
        (FLAT, {"w": 128, "h": 96}, "images/000.png is 128×96 pixels of its own"),
        ({**FLAT, "camera_model": "PINHOLE", "k1": 0.1}, {}, "k1=0.1 .*camera_model=PINHOLE does not have"),
        ({**FLAT, "camera_model": "OPENCV_FISHEYE", "p1": 0.1}, {}, "p1=0.1 .*does not have"),
        ({**FLAT, "k5": 0.1}, {}, "k5=0.1 .*camera_model=OPENCV does not have"),
        ({**FLAT, "camera_model": "OPENCV", "is_fisheye": True}, {}, "contradict each other"),
        ({**FLAT, "camera_model": "OPENCV_FISHEYE", "is_fisheye": False}, {}, "contradict each other"),
    ],
)
def test_frames_that_contradict_themselves(
    tmp_path: Path, shared: dict[str, Any], frame: dict[str, Any], message: str
) -> None:
    root = write(write_capture(tmp_path / "bench", NAMES_OF_TEN), shared, **frame)
    with pytest.raises(DatasetError, match=rf"transforms\.json: .*{message}"):
        load(root)


@pytest.mark.parametrize(
    "shared",
    [
        {**FLAT, "camera_angle_x": ANGLE, "camera_angle_y": 2 * math.atan(24 / 60)},
        {**FLAT, "w": 128, "h": 96, "fl_x": 120, "fl_y": 120, "cx": 64, "cy": 48},  # files are reduced copies
        NO_SIZE,
        {"camera_angle_x": ANGLE},
        {**FLAT, "camera_model": "OPENCV_FISHEYE", "is_fisheye": True},
    ],
    ids=["angles", "reduced copies", "no size", "angle alone", "fisheye"],
)
def test_frames_that_agree_with_themselves(tmp_path: Path, shared: dict[str, Any]) -> None:
    view = load(write(write_capture(tmp_path / "bench", NAMES_OF_TEN), shared)).train[0]
    np.testing.assert_allclose(view.camera.intrinsics, [[60, 0, 32], [0, 60, 24], [0, 0, 1]], atol=3)


def test_reduced_copies_need_a_size(tmp_path: Path) -> None:
    root = write(write_capture(tmp_path / "bench", NAMES_OF_TEN), {"fl_x": 60})
    (root / "images").rename(root / "images_2")
    with pytest.raises(
        DatasetError, match=r"fl_x for images/000.png and no size, and dataset.images names other files"
    ):
        load(root, images="images_2")
