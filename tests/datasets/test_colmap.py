"""COLMAP captures: against hand-written models, closed-form distortion, and pycolmap's own observations."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
import torch
from captures import HEIGHT, OPENCV, POINTS, WIDTH, center_of, gradient, rotation_of, write_capture
from PIL import Image

from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.formats.colmap_model import Model
from envgs_bench.datasets.notes import collecting
from envgs_bench.datasets.sources import capture

NAMES = [f"{index:03d}.png" for index in range(10)]

needs_captures = pytest.mark.skipif(
    "ENVGS_BENCH_DATA" not in os.environ, reason="ENVGS_BENCH_DATA names no folder of real captures"
)


def load(root: Path, **settings: Any) -> Scene:
    return load_scene({"kind": "colmap", "root": str(root), **settings}, root.parent / "cache")


def views_of(scene: Scene) -> dict[str, View]:
    return {view.name: view for view in [*scene.train, *scene.test]}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_capture(tmp_path / "bench", NAMES)


def test_points_may_lie_in_a_ply_beside_cameras_and_images(root: Path) -> None:
    rows = [" ".join(map(repr, point)) for point in POINTS.tolist()]
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n" + "".join(f"property double {a}\n" for a in "xyz")
    (root / "sparse/0/points3D.ply").write_text(head + "end_header\n" + "\n".join(rows) + "\n")
    write_binary(root, "binary")
    for model in ("sparse/0", "binary"):
        (root / model / "points3D.ply").write_bytes((root / "sparse/0/points3D.ply").read_bytes())
        next((root / model).glob("points3D.[bt]*")).unlink()
        np.testing.assert_allclose(load(root, model=model).points, POINTS, atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_text_model_with_byte_order_marks_is_read_as_without(root: Path, encoding: str) -> None:
    plain = load(root)
    for path in (root / "sparse/0").glob("*.txt"):
        path.write_text(path.read_text(), encoding=encoding)
    assert [view.name for view in load(root).train] == [view.name for view in plain.train]
    assert torch.equal(load(root).points, plain.points)


def test_names_in_a_text_model_may_have_spaces(tmp_path: Path) -> None:
    """Each is its own picture, beside files that are called as a name is up to its first space."""
    names = [f"shot  {i} (a).png" for i in range(9)]
    root = write_capture(tmp_path / "bench", [*names, "shot.png"])
    Image.fromarray(255 - gradient()).save(root / "images/shot.png")
    found = views_of(load(root))
    assert set(found) == {Path(name).stem for name in (*names, "shot.png")}
    for name in names:
        np.testing.assert_array_equal(found[Path(name).stem].image, gradient())


def write_binary(root: Path, folder: str) -> None:
    (root / folder).mkdir(parents=True)
    pycolmap.Reconstruction(str(root / "sparse/0")).write_binary(str(root / folder))


@pytest.mark.parametrize("form", ["text", "binary"])
def test_a_model_is_read_as_it_was_written(root: Path, form: str) -> None:
    if form == "binary":
        write_binary(root, "elsewhere")
    scene = load(root, model="elsewhere" if form == "binary" else None)
    assert scene.name == "bench"
    assert [view.name for view in scene.test] == ["000", "008"]
    assert [view.name for view in scene.train] == ["001", "002", "003", "004", "005", "006", "007", "009"]
    np.testing.assert_allclose(scene.points, POINTS, atol=1e-6)
    np.testing.assert_allclose(255 * scene.point_colors[:, 0], [10 * i % 256 for i in range(30)], atol=1e-4)
    for index, name in enumerate(NAMES):
        view = views_of(scene)[Path(name).stem]
        np.testing.assert_allclose(view.camera.center, center_of(index), atol=1e-6)
        np.testing.assert_allclose(view.camera.world_to_camera[:3, :3], rotation_of(index), atol=1e-6)
        np.testing.assert_allclose(view.camera.intrinsics, [[60, 0, 30.5], [0, 62, 25], [0, 0, 1]], atol=1e-5)
        np.testing.assert_array_equal(view.image, gradient())
        assert (view.masks, view.normal, view.depth) == ({}, None, None)


@pytest.mark.parametrize("folder", ["sparse/0", "sparse"])
def test_the_model_is_found(tmp_path: Path, folder: str) -> None:
    assert len(load(write_capture(tmp_path / "bench", NAMES, model=folder)).train) == 8


def test_of_several_models_the_largest_is_taken(tmp_path: Path) -> None:
    root = write_capture(tmp_path / "bench", NAMES[:3])
    write_capture(tmp_path / "bench", NAMES[3:], model="sparse/1")
    with collecting() as notes:
        assert len([*load(root).train, *load(root).test]) == 7
    assert "sparse/1: taken, the largest of 2 models (images: sparse/0 3, sparse/1 7)" in notes[0]
    with collecting() as notes:
        assert len([*(chosen := load(root, model="sparse/0")).train, *chosen.test]) == 3
    assert not any("the largest" in note for note in notes)


def expected_gradient(camera: Camera, distort: Any) -> np.ndarray:
    """What the gradient picture holds where `distort` sends the camera's rays, [H, W, 2] of red and green bytes."""
    y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.intrinsics.double().numpy()).T
    column, row = distort(pixels[..., 0], pixels[..., 1])
    return 255 * np.stack([column / WIDTH, row / HEIGHT], axis=-1)


def opencv_distortion(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """OpenCV's manual: radial k1, k2 and tangential p1, p2; then pixels."""
    k1, k2, p1, p2 = 0.06, -0.03, 0.002, -0.001
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    column = 60 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)) + 30.5
    row = 62 * (y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y) + 25
    return column, row


def test_undistortion_follows_the_published_formula(tmp_path: Path) -> None:
    scene = load(write_capture(tmp_path / "bench", NAMES, OPENCV))
    view = scene.train[0]
    expected = expected_gradient(view.camera, opencv_distortion)
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(view.image[..., :2].numpy()[inner], expected[inner], atol=1.6)


@pytest.mark.parametrize(
    "camera",
    [
        "SIMPLE_PINHOLE 64 48 61.0 30.5 25.0",
        "SIMPLE_RADIAL 64 48 61.0 30.5 25.0 0.05",
        "RADIAL 64 48 61.0 30.5 25.0 0.05 -0.02",
        "FULL_OPENCV 64 48 60.0 62.0 30.5 25.0 0.05 -0.02 0.001 0.001 0.01 0.01 0.0 0.0",
        "OPENCV_FISHEYE 64 48 60.0 62.0 30.5 25.0 0.02 0.01 0.0 0.0",
        "SIMPLE_RADIAL_FISHEYE 64 48 61.0 30.5 25.0 0.02",
    ],
    ids=lambda camera: camera.split()[0],
)
def test_every_camera_model_becomes_a_pinhole(tmp_path: Path, camera: str) -> None:
    view = load(write_capture(tmp_path / "bench", NAMES, camera)).train[0]
    model, width, height, *params = camera.split()
    own = pycolmap.Camera(model=model, width=int(width), height=int(height), params=[float(p) for p in params])

    def distort(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pixels = own.img_from_cam(np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)).reshape(*x.shape, 2)
        return pixels[..., 0], pixels[..., 1]

    inner = (slice(2, -2), slice(2, -2))
    expected = expected_gradient(view.camera, distort)
    np.testing.assert_allclose(view.image[..., :2].numpy()[inner], expected[inner], atol=1.6)


@pytest.mark.parametrize(("downsample", "size"), [(2, (24, 32)), (3, (16, 21)), (1.5, (32, 43))])
def test_downsampling_is_the_area_mean_and_intrinsics_follow(
    root: Path, downsample: float, size: tuple[int, int]
) -> None:
    view = load(root, downsample=downsample).train[0]
    height, width = size
    assert view.image.shape == (height, width, 3)
    assert (view.camera.height, view.camera.width) == size
    expected = torch.nn.functional.interpolate(
        torch.from_numpy(gradient()).permute(2, 0, 1)[None].float(), (height * HEIGHT, width * WIDTH), mode="nearest"
    )
    expected = torch.nn.functional.avg_pool2d(expected, (HEIGHT, WIDTH))[0].permute(1, 2, 0)
    np.testing.assert_allclose(view.image, expected, atol=0.51)
    scale = np.array([[width / WIDTH], [height / HEIGHT], [1]])
    np.testing.assert_allclose(view.camera.intrinsics, scale * [[60, 0, 30.5], [0, 62, 25], [0, 0, 1]], rtol=1e-6)


def test_images_may_be_reduced_copies_of_the_model_s(root: Path) -> None:
    for name in NAMES:
        Image.fromarray(gradient(32, 24)).save(root / "images" / name)
    view = load(root).train[0]
    assert view.image.shape == (24, 32, 3)
    np.testing.assert_allclose(view.camera.intrinsics, [[30, 0, 15.25], [0, 31, 12.5], [0, 0, 1]], rtol=1e-6)


def test_subfolders_and_any_extension(tmp_path: Path) -> None:
    names = ["left/1.JPG", "left/2.bmp", "right/1.tiff", "right/2.webp"]
    root = write_capture(tmp_path / "bench", names)
    (root / "images/left/2.bmp").rename(root / "images/left/2.png")  # converted since
    views = views_of(load(root))
    assert sorted(views) == ["left_1", "left_2", "right_1", "right_2"]
    for view in views.values():
        assert np.abs(view.image.numpy().astype(int) - gradient()).mean() < 3


def test_gray_and_transparent_images(root: Path) -> None:
    Image.fromarray(gradient()).convert("L").save(root / "images/001.png")
    alpha = np.full((HEIGHT, WIDTH, 1), 51, dtype=np.uint8)
    Image.fromarray(np.concatenate([gradient(), alpha], axis=-1)).save(root / "images/002.png")
    scene = load(root, background=[1, 0, 0.2])
    views = views_of(scene)
    np.testing.assert_allclose(scene.background, [1, 0, 0.2])
    assert (views["001"].image[..., 0] == views["001"].image[..., 2]).all()
    np.testing.assert_allclose(views["002"].image, 0.2 * gradient() + 0.8 * np.array([255, 0, 51]), atol=1.1)


def write_masks(root: Path, folder: str, ending: str, value: int = 255) -> np.ndarray:
    inside = np.zeros((HEIGHT, WIDTH), dtype=bool)
    inside[10:30, 20:44] = True
    (root / folder).mkdir()
    for name in NAMES:
        Image.fromarray(np.where(inside, value, 0).astype(np.uint8)).save(root / folder / (Path(name).stem + ending))
    return inside


def test_masks_become_regions(root: Path) -> None:
    inside = write_masks(root, "masks", ".png")
    write_masks(root, "masks_glass", ".png.png", value=1)
    for view in views_of(load(root)).values():
        assert set(view.masks) == {"foreground", "glass"}
        np.testing.assert_array_equal(view.masks["foreground"], inside)
        np.testing.assert_array_equal(view.masks["glass"], inside)
    np.testing.assert_array_equal(load(root, downsample=2).train[0].masks["foreground"], inside[::2, ::2])


def test_masks_are_undistorted_with_their_image(tmp_path: Path) -> None:
    """The mask of the picture's right half keeps its edge where red passes one half."""
    root = write_capture(tmp_path / "bench", NAMES, OPENCV)
    (root / "masks").mkdir()
    for name in NAMES:
        Image.fromarray(np.where(gradient()[..., 0] >= 128, 255, 0).astype(np.uint8)).save(root / "masks" / name)
    view = load(root).train[0]
    red = view.image[..., 0].int()
    sure = (red - 127.5).abs() > 3
    assert torch.equal(view.masks["foreground"][sure], (red >= 128)[sure])


@pytest.mark.parametrize("frame", ["world", "camera"])
def test_normals_are_turned_to_the_world_and_to_the_camera(root: Path, frame: str) -> None:
    normal = np.array([0.48, -0.36, -0.8])
    (root / "normals").mkdir()
    for index, name in enumerate(NAMES):
        # every other one faces away, as some estimators leave them
        stored = (rotation_of(index) @ normal if frame == "camera" else normal) * (-1) ** index
        encoded = np.broadcast_to(np.round((stored * 0.5 + 0.5) * 255), (HEIGHT, WIDTH, 3)).astype(np.uint8).copy()
        encoded[:5] = 128  # unknown
        Image.fromarray(encoded).save(root / "normals" / name)
    for view in views_of(load(root, normals_frame=frame, exact_normals=True)).values():
        assert (view.normal[:5] == 0).all()
        np.testing.assert_allclose(view.normal[5:], np.broadcast_to(normal, (HEIGHT - 5, WIDTH, 3)), atol=0.012)
        np.testing.assert_allclose(view.normal[5:].norm(dim=-1), 1, atol=1e-5)


def test_a_cached_capture_is_the_same_and_a_changed_one_is_read_again(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_masks(root, "masks", ".png")
    first = load(root, downsample=2)
    with monkeypatch.context() as patch:
        patch.setattr(capture, "make_scene", lambda *_: pytest.fail("read again"))
        second = load(root, downsample=2)
    for a, b in zip([*first.train, *first.test], [*second.train, *second.test], strict=True):
        assert a.name == b.name
        assert torch.equal(a.image, b.image)
        assert torch.equal(a.masks["foreground"], b.masks["foreground"])
        assert torch.equal(a.camera.intrinsics, b.camera.intrinsics)
        assert (a.camera.width, a.camera.height) == (b.camera.width, b.camera.height)
    assert torch.equal(first.points, second.points)
    Image.fromarray(255 - gradient()).save(root / "images/001.png")
    assert not torch.equal(load(root, downsample=2).train[0].image, first.train[0].image)


@needs_captures
@pytest.mark.parametrize(
    ("name", "train", "test", "error"),
    [("fox", 43, 7, 0.463), ("lund_door", 10, 2, 0.165), ("gold_cape", 104, 15, 0.369), ("colmap_fox9", 7, 2, 0.627)],
)
def test_real_captures_reproject_as_they_say(tmp_path: Path, name: str, train: int, test: int, error: float) -> None:
    """Our cameras put the points where COLMAP observed them: mean over points of their tracks' mean distance."""
    root = Path(os.environ["ENVGS_BENCH_DATA"]) / name
    if not root.is_dir():
        pytest.skip(f"{root} is not there")
    scene = load_scene({"kind": "colmap", "root": str(root), "downsample": 4}, tmp_path)
    assert (len(scene.train), len(scene.test)) == (train, test)
    model = pycolmap.Reconstruction(str(root / "sparse/0"))
    place = {key: index for index, key in enumerate(sorted(model.points3D))}
    total, count = np.zeros(len(place)), np.zeros(len(place))
    for image in model.images.values():
        camera = views_of(scene)[Path(image.name).stem].camera
        full = model.cameras[image.camera_id]
        observed = [point for point in image.points2D if point.has_point3D()]
        index = np.array([place[point.point3D_id] for point in observed])
        pixels, _ = camera.resized(full.width, full.height).project(scene.points[index])
        np.add.at(total, index, np.linalg.norm(pixels.numpy() - np.array([point.xy for point in observed]), axis=1))
        np.add.at(count, index, 1)
    model.update_point_3d_errors()
    assert (total / count).mean() == pytest.approx(model.compute_mean_reprojection_error(), abs=5e-4)
    assert (total / count).mean() == pytest.approx(error, abs=0.01)


@needs_captures
def test_a_distorted_model_agrees_with_the_published_undistorted_one(tmp_path: Path) -> None:
    """The OPENCV model, undistorted here, against INRIA's converter's own cameras and pictures."""
    data = Path(os.environ["ENVGS_BENCH_DATA"])
    if not (data / "colmap_fox9").is_dir() or not (data / "fox/images_original").is_dir():
        pytest.skip("colmap_fox9 or fox/images_original is not there")
    root = tmp_path / "mixed"
    root.mkdir()
    (root / "images").symlink_to(data / "fox/images_original")
    (root / "sparse").symlink_to(data / "colmap_fox9/distorted_sparse")
    ours = views_of(load(root, downsample=4))
    theirs = views_of(load_scene({"kind": "colmap", "root": str(data / "colmap_fox9"), "downsample": 4}, tmp_path))
    assert set(ours) == set(theirs)
    for name, view in ours.items():
        assert view.image.shape == theirs[name].image.shape
        torch.testing.assert_close(view.camera.world_to_camera, theirs[name].camera.world_to_camera)
        torch.testing.assert_close(view.camera.intrinsics, theirs[name].camera.intrinsics, rtol=1e-4, atol=0.01)
        assert (view.image.float() - theirs[name].image.float()).abs().mean() < 3


def test_far_points_surround_the_cameras(root: Path) -> None:
    """Behind the model's own points, unchanged, they lie evenly on a sphere twice as wide as the training cameras'."""
    scene = load(root, far_points=500)
    np.testing.assert_allclose(scene.points[:30], POINTS, atol=1e-6)
    far = scene.points[30:].double()
    centers = torch.stack([view.camera.center for view in scene.train]).double()
    middle = centers.mean(0)
    assert far.shape == (500, 3)
    expected = 2 * (centers - middle).norm(dim=1).max().item()
    np.testing.assert_allclose((far - middle).norm(dim=1), expected, rtol=1e-5)
    np.testing.assert_allclose(far.mean(0), middle, atol=0.01 * expected)
    nearest = torch.cdist(far, far).fill_diagonal_(torch.inf).amin(1)
    assert nearest.min() > 0.7 * nearest.mean()
    assert (scene.point_colors[30:] == 0.5).all()
    assert scene.radius == load(root).radius


@needs_captures
def test_the_images_of_real_captures_are_listed_without_reading_their_points() -> None:
    """Models of several programs, in both forms."""
    files = sorted(Path(os.environ["ENVGS_BENCH_DATA"]).rglob("images.bin"))
    files += sorted(Path(os.environ["ENVGS_BENCH_DATA"]).rglob("images.txt"))
    for path in files:
        model = Model(path.parent)
        assert sorted(model.listed_images()) == sorted(image.name for image in model.content.images.values())
    assert len(files) >= 5
