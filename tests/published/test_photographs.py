"""Captures made of published photographs: here a corner whose planes, poses and lens are exact."""

from __future__ import annotations

import io
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from corner_photographs import FOCAL, HEIGHT, WIDTH, look, photograph
from PIL import Image

from envgs_bench.cli.main import main
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.export.photographs import export_photographs

VIEWS, SCALE = 8, 2
DISTORTION = {"k1": 0.12, "k2": -0.05, "p1": 0.004, "p2": -0.003}
LENS = pycolmap.Camera(
    model="OPENCV",
    width=SCALE * WIDTH,
    height=SCALE * HEIGHT,
    params=[SCALE * FOCAL, SCALE * FOCAL, SCALE * WIDTH / 2 + 7, SCALE * HEIGHT / 2 - 5, *DISTORTION.values()],
)
MADE_WIDTH = 200
OPENCV_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs through a lens, masks of their left half, and a transforms.json that names one photograph more."""
    root = tmp_path_factory.mktemp("published") / "fox"
    for folder in ("images", "masks"):
        (root / folder).mkdir(parents=True)
    mask = np.zeros((LENS.height, LENS.width), dtype=np.uint8)
    mask[:, : LENS.width // 2] = 255
    frames = []
    for index in range(VIEWS + 1):
        to_camera = np.eye(4)
        to_camera[:3, :3], center = look(index)
        to_camera[:3, 3] = -to_camera[:3, :3] @ center
        matrix = np.linalg.inv(to_camera) @ OPENCV_TO_OPENGL
        frames.append({"file_path": f"images/{index:04}.jpg", "transform_matrix": matrix.tolist()})
        if index < VIEWS:
            Image.fromarray(photograph(index, LENS)).save(root / f"images/{index:04}.jpg", quality=98)
            Image.fromarray(mask).save(root / f"masks/{index:04}.png")
    fx, fy, cx, cy = LENS.params[:4]
    lens = {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": LENS.width, "h": LENS.height, **DISTORTION}
    (root / "transforms.json").write_text(json.dumps({**lens, "aabb_scale": 4, "frames": frames}))
    return root


@pytest.fixture(scope="module")
def made(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("made") / "fox"
    source = {"kind": "transforms", "missing": "skip", "root": published}
    assert export_photographs(source, MADE_WIDTH, root, root.parent / "cache") == VIEWS
    return root


def test_points_lie_on_what_was_photographed_and_are_seen_where_the_model_says(made: Path) -> None:
    model = pycolmap.Reconstruction(str(made / "sparse/0"))
    points = np.array([point.xyz for point in model.points3D.values()])
    assert len(points) > 300
    distances = np.abs(points).min(axis=1)  # from the nearest of the planes x = 0, y = 0, z = 0
    assert np.median(distances) < 0.005
    assert np.quantile(distances, 0.95) < 0.05
    for image in model.images.values():
        seen = [point for point in image.points2D if point.has_point3D()]
        assert len(seen) > 50
        there = np.array([point.xy for point in seen])
        projected = np.array([image.project_point(model.points3D[point.point3D_id].xyz) for point in seen])
        assert np.median(np.linalg.norm(projected - there, axis=1)) < 0.3  # pixels


def test_poses_are_the_published_ones_and_pictures_what_a_pinhole_sees_there(made: Path) -> None:
    model = pycolmap.Reconstruction(str(made / "sparse/0"))
    (camera,) = model.cameras.values()
    assert (camera.model.name, camera.width) == ("PINHOLE", MADE_WIDTH)
    assert sorted(image.name for image in model.images.values()) == [f"{index:04}.png" for index in range(VIEWS)]
    for image in model.images.values():
        index = int(image.name[:4])
        rotation, center = look(index)
        np.testing.assert_allclose(image.projection_center(), center, atol=1e-9)
        np.testing.assert_allclose(image.cam_from_world().rotation.matrix(), rotation, atol=1e-9)
        picture = np.asarray(Image.open(made / "images" / image.name)).astype(float)
        error = picture - photograph(index, camera)
        assert 10 * np.log10(255**2 / (error**2).mean()) > 28


def test_masks_follow_the_pictures(made: Path) -> None:
    model = pycolmap.Reconstruction(str(made / "sparse/0"))
    (camera,) = model.cameras.values()
    columns = np.arange(camera.width) + 0.5
    middle_row = np.column_stack([columns, np.full_like(columns, camera.height / 2)])
    rays = np.column_stack([np.asarray(camera.cam_from_img(middle_row)), np.ones(len(columns))])
    left = np.asarray(LENS.img_from_cam(rays))[:, 0] < LENS.width / 2
    mask = np.asarray(Image.open(made / "masks/0003.png"))
    assert mask.shape == (camera.height, camera.width)
    assert (mask[camera.height // 2] > 0).tolist() == left.tolist()


def test_it_is_a_capture_whose_exposures_can_be_made_equal(made: Path, tmp_path: Path) -> None:
    scene = load_scene({"kind": "colmap", "root": str(made), "equalize_exposure": True}, tmp_path)
    assert (len(scene.train), len(scene.test)) == (7, 1)
    assert "foreground" in scene.test[0].masks


def test_one_command_makes_it_of_an_archive_or_of_photographs_that_are_here(
    published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = (f"data_root={tmp_path / 'data'}", f"cache_dir={tmp_path / 'cache'}")
    smaller = ("dataset.photographs.width=120",)
    root = tmp_path / "data/captures/fox"
    assert main(["download", "captures/fox", *places, *smaller, "--photographs", str(published)]) == 0
    assert f"{root}: {VIEWS} images and their model, made of {published}" in capsys.readouterr().out
    assert main(["download", "captures/fox", *places, "--photographs", str(published)]) == 0
    assert "is there already" in capsys.readouterr().out
    by_hand = {path.relative_to(root): path.read_bytes() for path in root.rglob("*") if path.is_file()}
    root.rename(tmp_path / "moved")

    url = "https://nowhere.invalid/instant-ngp.zip"
    archives = tmp_path / "cache/downloads"
    archives.mkdir()
    (archives / "instant-ngp.zip").write_bytes(packed(published, "instant-ngp-abe236ee/data/nerf/fox"))
    assert main(["download", "captures/fox", *places, *smaller, f"dataset.download={url}"]) == 0
    assert {path.relative_to(root): path.read_bytes() for path in root.rglob("*") if path.is_file()} == by_hand
    assert [path.name for path in archives.iterdir()] == ["instant-ngp.zip"]
    assert [path.name for path in root.parent.iterdir()] == ["fox"]


def packed(folder: Path, name: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, f"{name}/{path.relative_to(folder)}")
    return stream.getvalue()


def test_what_cannot_be_made_is_explained_and_leaves_nothing(
    published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = (f"data_root={tmp_path / 'data'}", f"cache_dir={tmp_path / 'cache'}")

    def fails(*arguments: str) -> str:
        assert main(["download", *arguments, *places]) == 1
        assert not (tmp_path / "data").exists()
        return capsys.readouterr().err

    assert "fox: 455 pixels wide once undistorted; expected 540 at least" in fails(
        "captures/fox", "--photographs", str(published)
    )
    assert "there is no such folder" in fails("captures/fox", "--photographs", str(tmp_path / "none"))
    assert "1 of 9 images that it names are not there" in fails(
        "captures/fox", "--photographs", str(published), "dataset.photographs.source.missing=refuse"
    )
    assert "is not made of photographs" in fails("ref_real/sedan", "--photographs", str(published))


def test_photographs_that_share_nothing_are_refused(published: Path, tmp_path: Path) -> None:
    root = tmp_path / "gray"
    (root / "images").mkdir(parents=True)
    (root / "transforms.json").symlink_to(published / "transforms.json")
    for index in range(VIEWS):
        Image.fromarray(np.full((LENS.height, LENS.width), 90, dtype=np.uint8)).save(root / f"images/{index:04}.jpg")
    source = {"kind": "transforms", "missing": "skip", "root": root}
    with pytest.raises(DatasetError, match=r"images: 8 images share no point that fits their poses; check these"):
        export_photographs(source, MADE_WIDTH, tmp_path / "made", tmp_path / "cache")
    assert not list((tmp_path / "cache").rglob("*.part"))
    assert not (tmp_path / "made").exists()


def test_photographs_that_their_cameras_turned_are_refused(published: Path, tmp_path: Path) -> None:
    root = tmp_path / "turned"
    (root / "images").mkdir(parents=True)
    (root / "transforms.json").symlink_to(published / "transforms.json")
    quarter = Image.Exif()
    quarter[0x0112] = 6  # Orientation: turn it by 90 degrees to see it upright
    for path in (published / "images").iterdir():
        Image.open(path).transpose(Image.Transpose.ROTATE_90).save(root / "images" / path.name, exif=quarter)
    with pytest.raises(DatasetError, match=r"transforms\.json: points need pixels .* save upright: 0000\.jpg"):
        export_photographs({"kind": "transforms", "missing": "skip", "root": root}, 100, tmp_path / "m", tmp_path / "c")


@pytest.mark.slow
def test_the_fox_is_made_as_its_results_used_it(tmp_path: Path) -> None:
    data = Path(os.environ.get("ENVGS_BENCH_DATA", ""))
    if not os.environ.get("ENVGS_BENCH_DATA") or not (data / "fox/images_original").is_dir():
        pytest.skip("$ENVGS_BENCH_DATA/fox/images_original is not there")
    (tmp_path / "fox").mkdir()
    (tmp_path / "fox/images").symlink_to(data / "fox/images_original")
    (tmp_path / "fox/transforms.json").symlink_to(data / "fox/transforms_original.json")
    places = (f"data_root={tmp_path}", f"cache_dir={tmp_path / 'cache'}")
    assert main(["download", "captures/fox", *places, "--photographs", str(tmp_path / "fox")]) == 0
    made = pycolmap.Reconstruction(str(tmp_path / "captures/fox/sparse/0"))
    used = pycolmap.Reconstruction(str(data / "fox/sparse/0"))
    assert [camera.todict() for camera in made.cameras.values()] == [c.todict() for c in used.cameras.values()]
    poses = {Path(image.name).stem: image for image in used.images.values()}
    assert len(made.images) == len(poses) == 50
    for image in made.images.values():
        other = poses[Path(image.name).stem]
        np.testing.assert_allclose(image.projection_center(), other.projection_center(), atol=1e-5)
    assert made.num_points3D() > 0.8 * used.num_points3D()
