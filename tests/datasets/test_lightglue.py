"""Learned features of photographs: networks that know the scene stand in for the trained ones; the poses are exact."""

from __future__ import annotations

import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import kornia.core.download
import kornia.feature
import numpy as np
import pycolmap
import pytest
import torch
from kornia.feature import DISK, DISKFeatures, LightGlue
from PIL import Image
from torch import Tensor, nn

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.photographs import lightglue

WIDTH, HEIGHT, FOCAL = 240, 180, 220.0
VIEWS, POINTS, KINDS = 7, 250, 128
SHADE = 30  # an image's gray is this times its index: the only thing that is seen on it
DISK_FILE, LIGHTGLUE_FILE = lightglue.WEIGHTS


def load(root: Path, cache: Path, **settings: Any) -> Scene:
    common = {"kind": "photos", "root": str(root), "camera_model": "SIMPLE_PINHOLE", "matcher": "lightglue"}
    return load_scene({**common, **settings}, cache)


def points() -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.6, 0.6, (POINTS, 3))


def pose(index: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation of the world into the camera, and the camera's center: on an arc around the points."""
    angle = 0.15 * index
    center = np.array([3 * np.cos(angle), 3 * np.sin(angle), 0.8 * np.sin(1.3 * index)])
    forward = -center / np.linalg.norm(center)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward]), center


def projected(index: int) -> tuple[np.ndarray, np.ndarray]:
    """Most of the points in any order, and where they are in the view, in pixels from its corner."""
    rotation, center = pose(index)
    seen = np.random.default_rng(index).permutation(POINTS)[: POINTS * 4 // 5]
    x, y, z = rotation @ (points()[seen] - center).T
    return seen, np.stack([FOCAL * x / z + WIDTH / 2, FOCAL * y / z + HEIGHT / 2], axis=1)


def descriptors() -> Tensor:
    return nn.functional.normalize(torch.randn(POINTS, KINDS, generator=torch.Generator().manual_seed(1)), dim=1)


class KnowingDetector(nn.Module):
    """In place of DISK: tells the view from the image's gray."""

    def forward(self, images: Tensor, n: int, pad_if_not_divisible: bool) -> list[DISKFeatures]:
        assert n == lightglue.KEYPOINTS
        assert pad_if_not_divisible
        _, _, height, width = images.shape
        index = round(float(images.mean()) * 255 / SHADE)
        seen, whole = projected(index)
        reduced = whole * [width / WIDTH, height / HEIGHT] - 0.5  # a pixel's center has whole coordinates
        return [DISKFeatures(torch.tensor(reduced).float(), descriptors()[seen], torch.ones(len(seen)))]


class KnowingMatcher(nn.Module):
    """In place of LightGlue: matches equal descriptors, and some that are not."""

    def forward(self, data: dict[str, dict[str, Tensor]]) -> dict[str, list[Tensor]]:
        first, second = data["image0"], data["image1"]
        for image in (first, second):
            assert image["image_size"].shape == (1, 2)
            assert (image["keypoints"] < image["image_size"]).all()
        same = (first["descriptors"][0] @ second["descriptors"][0].T > 0.999).nonzero()
        same[::10, 1] = same[::10, 1].roll(1)
        return {"matches": [same]}


@pytest.fixture
def networks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DISK, "from_pretrained", lambda *_: KnowingDetector())
    monkeypatch.setattr(kornia.feature, "LightGlue", lambda *_: KnowingMatcher().eval())


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """Photographs of one color each."""
    (tmp_path / "plain").mkdir()
    for index in range(VIEWS):
        Image.new("RGB", (WIDTH, HEIGHT), (SHADE * index,) * 3).save(tmp_path / f"plain/view {index}.png")
    return tmp_path / "plain"


@pytest.mark.parametrize("feature_size", [240, 101])  # 101 × 76 pixels: not quite the photographs' shape
@pytest.mark.usefixtures("networks")
def test_exact_matches_give_exact_cameras(plain: Path, tmp_path: Path, feature_size: int) -> None:
    scene = load(plain, tmp_path / "cache", feature_size=feature_size)
    views = sorted([*scene.train, *scene.test], key=lambda view: view.name)
    assert len(views) == VIEWS
    found = [view.camera for view in views]
    np.testing.assert_allclose(found[0].intrinsics[0, 0], FOCAL, rtol=5e-3)  # bundle adjustment stops there
    first_rotation, first_center = pose(0)
    origin, unit = found[0].center.numpy(), np.linalg.norm(found[1].center - found[0].center)
    for index, camera in enumerate(found):
        rotation, center = pose(index)
        turn = camera.world_to_camera[:3, :3] @ found[0].world_to_camera[:3, :3].T
        np.testing.assert_allclose(turn, rotation @ first_rotation.T, atol=3e-3)
        moved = found[0].world_to_camera[:3, :3].numpy() @ (camera.center.numpy() - origin) / unit
        true = first_rotation @ (center - first_center) / np.linalg.norm(pose(1)[1] - first_center)
        np.testing.assert_allclose(moved, true, atol=1e-2)
    in_first = (found[0].world_to_camera[:3, :3].numpy() @ (scene.points.numpy() - origin).T).T / unit
    true = (first_rotation @ (points() - first_center).T).T / np.linalg.norm(pose(1)[1] - first_center)
    distances = np.linalg.norm(in_first[:, None] - true, axis=2).min(axis=1)
    assert len(scene.points) > 0.9 * POINTS
    assert np.quantile(distances, 0.95) < 0.01


@pytest.mark.usefixtures("networks")
def test_keypoints_stand_where_the_points_are_in_the_whole_image(plain: Path, tmp_path: Path) -> None:
    matcher, database, name = lightglue.LightGlue(feature_size=101), tmp_path / "database.db", "view 3.png"
    matcher.find_features(database, plain, [name], pycolmap.ImageReaderOptions())
    with pycolmap.Database.open(database) as opened:
        image = opened.read_image_with_name(name)
        found, camera = opened.read_keypoints(image.image_id), opened.read_camera(image.camera_id)
    np.testing.assert_allclose(found, projected(3)[1], atol=1e-3)
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)


@pytest.mark.usefixtures("networks")
def test_each_matcher_has_its_own_model(plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load(plain, tmp_path / "cache", feature_size=240)
    again = load(plain, tmp_path / "another cache", feature_size=240)
    assert torch.equal(first.points, again.points)
    assert torch.equal(first.train[2].camera.world_to_camera, again.train[2].camera.world_to_camera)
    with pytest.raises(DatasetError, match="plain: structure from motion placed none of 7 images"):
        load(plain, tmp_path / "cache", feature_size=240, matcher="sift")
    monkeypatch.setattr(DISK, "from_pretrained", lambda *_: pytest.fail("features were looked for again"))
    kept = load(plain, tmp_path / "cache", feature_size=240, name="another scene, of the same model")
    assert torch.equal(first.points, kept.points)


@pytest.mark.usefixtures("networks")
def test_images_without_features(plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: Any, **__: Any) -> list[DISKFeatures]:
        return [DISKFeatures(torch.zeros(0, 2), torch.zeros(0, KINDS), torch.zeros(0))]

    monkeypatch.setattr(KnowingDetector, "forward", nothing)
    with pytest.raises(DatasetError, match="plain: structure from motion placed none of 7 images"):
        load(plain, tmp_path / "cache")


@pytest.mark.usefixtures("networks")
def test_an_image_that_pycolmap_cannot_read(plain: Path, tmp_path: Path) -> None:
    Image.new("RGB", (WIDTH, HEIGHT)).save(plain / "view 0.webp")
    with pytest.raises(DatasetError, match=r"plain/view 0\.webp: pycolmap cannot read it; save it as PNG or JPEG"):
        load(plain, tmp_path / "cache")


def test_an_unknown_matcher(plain: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"matcher.*'sift' or 'lightglue'"):
        load(plain, tmp_path / "cache", matcher="superglue")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """No network; the addresses that were asked for all the same."""
    addresses: list[str] = []

    def refuse(request: urllib.request.Request, **_: Any) -> None:
        addresses.append(request.full_url)
        raise urllib.error.URLError("no route to host")

    monkeypatch.setattr(kornia.core.download, "urlopen", refuse)
    monkeypatch.setattr(time, "sleep", lambda _: None)
    return addresses


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: list[str]) -> Path:
    """Where torch.hub keeps weights; it is empty."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    folder = tmp_path / "hub/checkpoints"
    folder.mkdir(parents=True)
    return folder


def put_weights(hub: Path) -> tuple[DISK, LightGlue]:
    """Of the networks' true shapes, and random."""
    detector, matcher = DISK(), LightGlue(None, input_dim=KINDS)
    torch.save({"extractor": detector.state_dict()}, hub / DISK_FILE)
    torch.save(matcher.state_dict(), hub / LIGHTGLUE_FILE)
    return detector, matcher


def test_weights_that_lie_where_the_message_says_are_taken(hub: Path) -> None:
    detector, matcher = put_weights(hub)
    before = torch.get_rng_state()
    found = lightglue.LightGlue(feature_size=100)
    assert torch.equal(torch.get_rng_state(), before)
    for network, true in ((found.detector, detector), (found.matcher, matcher)):
        assert not network.training
        expected = true.state_dict()
        assert all(torch.equal(value.cpu(), expected[name]) for name, value in network.state_dict().items())
    noise = np.random.default_rng(0).integers(0, 256, (90, 150, 3), dtype=np.uint8)
    features = found._features(noise, image_id=1)
    assert features.size == (100, 60)
    assert len(features.keypoints) > 20
    assert features.descriptors.shape == (len(features.keypoints), KINDS)
    assert ((features.keypoints >= 0) & (features.keypoints < torch.tensor(features.size))).all()
    found.matcher.conf.filter_threshold = -1.0  # random weights are sure of nothing
    matches = found._matches(features, features)
    assert len(matches) > 0
    assert matches.dtype == np.uint32
    assert matches.max() < len(features.keypoints)


@pytest.mark.filterwarnings("ignore:.*no route to host")  # kornia's, at each attempt
def test_weights_that_cannot_be_had(hub: Path, asked: list[str], plain: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as raised:
        load(plain, tmp_path / "cache")
    assert lightglue.WEIGHTS[DISK_FILE] in asked
    for file, url in lightglue.WEIGHTS.items():
        assert f"{url} as {hub / file}" in str(raised.value)
    assert "no route to host" in str(raised.value)
    assert "dataset.matcher=sift" in str(raised.value)
    assert not list((tmp_path / "cache").rglob("*.part"))
    put_weights(hub)
    (hub / LIGHTGLUE_FILE).unlink()
    with pytest.raises(DatasetError, match=rf"{DISK_FILE} \(a file is there\); .*{LIGHTGLUE_FILE}; or"):
        load(plain, tmp_path / "cache")
    assert lightglue.WEIGHTS[LIGHTGLUE_FILE] in asked


def test_other_weights_are_refused(hub: Path) -> None:
    _, matcher = put_weights(hub)
    torch.save(
        {name: value for name, value in matcher.state_dict().items() if "input_proj" not in name}, hub / LIGHTGLUE_FILE
    )
    with pytest.raises(DatasetError, match=r"missing from LightGlue's file.*\(a file is there\)"):
        lightglue.LightGlue(feature_size=100)
    torch.save(matcher.state_dict(), hub / DISK_FILE)
    with pytest.raises(DatasetError, match="extractor"):
        lightglue.LightGlue(feature_size=100)
