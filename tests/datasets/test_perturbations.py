"""Each perturbation of a scene against an independent measure; what it does not concern stays as it is, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from skimage.color import rgb2lab
from skimage.metrics import peak_signal_noise_ratio
from toy_scenes import rough_toys

from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.testing import tiny_scene

SMALL = {"kind": "toy", "width": 64, "height": 48, "views": 33, "supersampling": 1}
OF_SCORED_VIEWS = ("background", "masks_grown", "masks_shrunk")
Perturb = Callable[..., Scene]


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Scene]:
    cache = tmp_path_factory.mktemp("cache")
    with rough_toys():
        return {name: load_scene({**SMALL, "scene": name}, cache) for name in ("chrome_room", "sky_ball")}


@pytest.fixture
def room(toys: dict[str, Scene]) -> Scene:
    return toys["chrome_room"]


def perturbed(scene: Scene, kind: str, severity: int, seed: int = 0) -> Scene:
    return PERTURBATIONS[kind].applied(scene, severity, kind, seed)


def gray_scene(count: int = 40, value: int = 128, size: int = 48) -> Scene:
    """Cameras without a turn along a line, that all see one gray."""
    camera = Camera(torch.eye(4), torch.tensor([[40.0, 0, size / 2], [0, 40, size / 2], [0, 0, 1]]), size, size)
    image = torch.full((size, size, 3), value, dtype=torch.uint8)
    poses = [torch.eye(4) for _ in range(count)]
    for index, pose in enumerate(poses):
        pose[0, 3] = -index / count
    views = [View(f"{index:03d}", replace(camera, world_to_camera=pose), image) for index, pose in enumerate(poses)]
    return Scene("gray", views[1:], views[:1], torch.rand(200, 3), torch.rand(200, 3))


def same_view(a: View, b: View) -> bool:
    tensors = [(a.image, b.image), (a.camera.world_to_camera, b.camera.world_to_camera), (a.normal, b.normal)]
    tensors += [(a.depth, b.depth), *((a.masks[name], b.masks[name]) for name in a.masks)]
    return all(torch.equal(x, y) if x is not None and y is not None else x is y for x, y in tensors)


def unchanged(a: Scene, b: Scene) -> set[str]:
    """Which parts of two scenes are equal, bit for bit."""
    parts = {
        "test": len(a.test) == len(b.test) and all(map(same_view, a.test, b.test)),
        "train": len(a.train) == len(b.train) and all(map(same_view, a.train, b.train)),
        "points": a.points.shape == b.points.shape and torch.equal(a.points, b.points),
        "background": torch.equal(a.background, b.background),
    }
    return {part for part, same in parts.items() if same}


@pytest.mark.parametrize("kind", [kind for kind in PERTURBATIONS if kind not in OF_SCORED_VIEWS])
def test_test_views_stay_bit_for_bit_and_one_thing_changes(room: Scene, kind: str) -> None:
    changed = perturbed(room, kind, len(PERTURBATIONS[kind].levels))
    of_points = kind.startswith("points_")
    assert unchanged(room, changed) == {"test", "background", "train" if of_points else "points"}
    assert [view.name for view in changed.test] == [view.name for view in room.test]
    assert changed.name == room.name


@pytest.mark.parametrize("kind", [kind for kind in PERTURBATIONS if kind != "background"])
def test_the_seed_decides_and_a_generator_of_ones_own_leaves_the_others_alone(room: Scene, kind: str) -> None:
    before = torch.get_rng_state()
    first, again, other = (perturbed(room, kind, 1, seed) for seed in (0, 0, 1))
    everything = {"test", "train", "points", "background"}
    assert unchanged(first, again) == everything
    drawn_at_random = kind not in ("blur", "jpeg", "points_near_cameras", "masks_grown", "masks_shrunk")
    assert (unchanged(first, other) == everything) != drawn_at_random
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("kind", PERTURBATIONS)
def test_every_kind_has_three_levels_and_words_for_each(kind: str) -> None:
    perturbation = PERTURBATIONS[kind]
    assert len(perturbation.levels) >= 3
    words = [perturbation.level(severity) for severity in range(1, len(perturbation.levels) + 1)]
    assert len(set(words)) == len(words)


@pytest.mark.parametrize("severity", [1, 2, 3])
def test_noise_has_the_psnr_that_its_deviation_says(severity: int) -> None:
    scene = gray_scene()
    deviation = PERTURBATIONS["noise"].levels[severity - 1]
    noisy = perturbed(scene, "noise", severity)
    psnr = [
        peak_signal_noise_ratio(a.rgb().numpy(), b.rgb().numpy(), data_range=1)
        for a, b in zip(scene.train, noisy.train, strict=True)
    ]
    rounding = 1 / 12 / 255**2  # of bytes
    assert np.mean(psnr) == pytest.approx(-10 * np.log10(deviation**2 + rounding), abs=0.05)


@pytest.mark.parametrize("severity", [1, 2])
def test_exposures_deviate_by_the_stops_that_the_level_says(severity: int) -> None:
    """In linear light, by IEC 61966-2-1's curve; from dark gray, so that nothing is clamped."""
    scene = gray_scene(count=400, value=60, size=8)
    exposed = perturbed(scene, "exposure", severity)
    values = np.array([view.image.numpy()[0, 0] for view in exposed.train]) / 255
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    stops = np.log2(linear / ((60 / 255 + 0.055) / 1.055) ** 2.4)
    assert stops.std() == pytest.approx(PERTURBATIONS["exposure"].levels[severity - 1], rel=0.12)
    assert abs(stops.mean()) < 3 * stops.std() / np.sqrt(len(stops))
    assert (values == values[:, :1]).all()


def test_white_balance_turns_gray_red_or_blue_and_leaves_green() -> None:
    scene = gray_scene()
    colors = np.stack([view.image.numpy()[0, 0] for view in perturbed(scene, "white_balance", 2).train])
    assert (colors[:, 1] == 128).all()
    assert np.abs(rgb2lab(colors / 255)[:, 1:]).mean() > 3  # a*, b*: 0 for gray
    assert colors[:, 0].std() > 3
    assert colors[:, 2].std() > 3


def test_blur_is_scipys_gaussian(room: Scene) -> None:
    sigma = PERTURBATIONS["blur"].levels[2] * 64
    blurred = perturbed(room, "blur", 3).train[5].rgb()
    expected = ndimage.gaussian_filter(room.train[5].rgb().double().numpy(), (sigma, sigma, 0), mode="mirror")
    assert np.abs(blurred.numpy() - expected).max() < 0.75 / 255


def test_jpegs_are_worse_the_lower_their_quality_and_as_pillow_reads_them(room: Scene, tmp_path: Path) -> None:
    original = room.train[3].image.numpy()
    psnr = [
        peak_signal_noise_ratio(original, perturbed(room, "jpeg", severity).train[3].image.numpy())
        for severity in (1, 2, 3)
    ]
    assert 40 > psnr[0] > psnr[1] > psnr[2] > 10
    Image.fromarray(original).save(tmp_path / "x.jpg", quality=5, subsampling=2)
    assert (perturbed(room, "jpeg", 3).train[3].image.numpy() == np.asarray(Image.open(tmp_path / "x.jpg"))).all()


@pytest.mark.parametrize(("severity", "count"), [(1, 24), (2, 12), (3, 6), (4, 3)])
def test_views_are_as_few_as_the_level_says_and_go_all_around(room: Scene, severity: int, count: int) -> None:
    kept = [view.name for view in perturbed(room, "views", severity).train]
    names = [view.name for view in room.train]
    assert len(kept) == len(set(kept)) == count
    gaps = np.diff([names.index(name) for name in kept])
    assert set(gaps) <= {len(names) // count, len(names) // count + 1}


def test_views_that_are_not_there_cannot_be_kept() -> None:
    with pytest.raises(DatasetError, match="has 5 training views, expected more than 6 to keep 6 of"):
        perturbed(tiny_scene(), "views", 3)


@pytest.mark.parametrize("severity", [1, 2, 3])
def test_cameras_turn_by_the_angle_of_the_level_and_stay_where_they_are(severity: int) -> None:
    scene = gray_scene(count=400, size=8)
    turned = perturbed(scene, "pose_rotation", severity)
    before, after = (
        Rotation.from_matrix([view.camera.world_to_camera[:3, :3].double().numpy() for view in each.train])
        for each in (scene, turned)
    )
    degrees = np.degrees((after * before.inv()).magnitude())
    assert degrees.mean() == pytest.approx(PERTURBATIONS["pose_rotation"].levels[severity - 1], rel=0.06)
    centers = [torch.stack([view.camera.center for view in each.train]) for each in (scene, turned)]
    assert torch.allclose(*centers, atol=1e-5)


def test_normals_turn_with_a_camera_that_is_turned(room: Scene) -> None:
    """In the camera's own axes they are what they were."""
    for before, after in zip(room.train[:4], perturbed(room, "pose_rotation", 3).train[:4], strict=True):
        in_camera = [view.normal @ view.camera.world_to_camera[:3, :3].T for view in (before, after)]
        assert torch.allclose(*in_camera, atol=1e-5)
        assert not torch.allclose(before.normal, after.normal, atol=1e-3)


@pytest.mark.parametrize("severity", [1, 2, 3])
def test_cameras_shift_by_the_share_of_the_radius_and_keep_looking_the_same_way(severity: int) -> None:
    scene = gray_scene(count=400, size=8)
    shifted = perturbed(scene, "pose_translation", severity)
    moves = torch.stack(
        [b.camera.center - a.camera.center for a, b in zip(scene.train, shifted.train, strict=True)]
    ).norm(dim=1)
    share = PERTURBATIONS["pose_translation"].levels[severity - 1]
    assert float(moves.mean()) / scene.radius == pytest.approx(share, rel=0.06)
    assert all(
        torch.equal(a.camera.world_to_camera[:3, :3], b.camera.world_to_camera[:3, :3])
        for a, b in zip(scene.train, shifted.train, strict=True)
    )


@pytest.mark.parametrize(("severity", "divisor"), [(1, 2), (2, 8), (3, 32)])
@pytest.mark.parametrize("kind", ["points_fewer", "points_near_cameras"])
def test_points_are_a_part_of_the_points(room: Scene, kind: str, severity: int, divisor: int) -> None:
    changed = perturbed(room, kind, severity)
    assert len(changed.points) == pytest.approx(len(room.points) / divisor, abs=1)
    distance, index = cKDTree(room.points.numpy()).query(changed.points.numpy())
    assert (distance == 0).all()
    assert len(set(index.tolist())) == len(index)
    assert torch.equal(changed.point_colors, room.point_colors[index])


def test_the_points_that_are_kept_near_cameras_are_the_nearest(room: Scene) -> None:
    cameras = torch.stack([view.camera.center for view in room.train])
    kept = torch.cdist(perturbed(room, "points_near_cameras", 2).points, cameras).amin(1)
    everyone = torch.cdist(room.points, cameras).amin(1)
    assert float(kept.max()) == pytest.approx(float(everyone.sort().values[len(kept) - 1]), abs=1e-5)


@pytest.mark.parametrize(("severity", "share"), [(1, 1 / 2), (2, 1 / 8), (3, 0.0)])
def test_points_that_are_far_go_and_all_others_stay(severity: int, share: float) -> None:
    scene = gray_scene()
    away = torch.cat([torch.full((40,), 1.4), torch.full((80,), 1.6)]) * scene.radius
    cameras = torch.stack([view.camera.center for view in scene.train])
    outward = cameras[0] - cameras.mean(dim=0)
    points = cameras[0] + away[:, None] * outward / outward.norm()
    scene = replace(scene, points=points, point_colors=torch.full_like(points, 0.5))
    kept = perturbed(scene, "points_far_fewer", severity).points
    assert torch.equal(kept[:40], points[:40])
    assert len(kept) == 40 + round(80 * share)


@pytest.mark.parametrize("severity", [1, 2, 3])
def test_noisy_points_are_off_by_the_share_of_the_radius(room: Scene, severity: int) -> None:
    noise = (perturbed(room, "points_noisy", severity).points - room.points) / room.radius
    assert float(noise.std()) == pytest.approx(PERTURBATIONS["points_noisy"].levels[severity - 1], rel=0.03)
    assert torch.equal(perturbed(room, "points_noisy", severity).point_colors, room.point_colors)


@pytest.mark.parametrize(("severity", "share"), [(1, 0.5), (2, 0.9), (3, 1.0)])
def test_points_at_cameras_are_at_their_centers(room: Scene, severity: int, share: float) -> None:
    cameras = torch.stack([view.camera.center for view in room.train])
    distance = cKDTree(cameras.numpy()).query(perturbed(room, "points_at_cameras", severity).points.numpy())[0]
    assert np.mean(distance < 1e-6) == pytest.approx(share, abs=1e-3)


def test_random_points_fill_the_box_and_the_larger_ones_volume(room: Scene) -> None:
    low, high = (torch.quantile(room.points, q, dim=0) for q in (0.0025, 0.9975))
    for severity, extent in ((1, 1), (2, 2), (3, 4)):
        points = (perturbed(room, "points_random", severity).points - (low + high) / 2) / (high - low)
        assert len(points) == len(room.points)
        assert torch.allclose(points.amax(0), torch.full((3,), extent / 2), atol=0.01 * extent)
        assert torch.allclose(points.std(0), torch.full((3,), extent / np.sqrt(12)), rtol=0.05)


@pytest.mark.parametrize("severity", [1, 2, 3])
def test_normals_are_off_by_the_angle_of_the_level(room: Scene, severity: int) -> None:
    angles = []
    for before, after in zip(room.train, perturbed(room, "normals_turned", severity).train, strict=True):
        known = before.depth > 0
        cosine = (before.normal.double() * after.normal.double()).sum(-1)[known].clamp(-1, 1)
        angles.append(float(torch.rad2deg(torch.acos(cosine)).mean()))
        assert torch.allclose(after.normal[known].norm(dim=-1), torch.ones(int(known.sum())), atol=1e-4)
        assert (after.normal[~known] == 0).all()
    # Views' own means differ, and large turns are cut where a normal would face away.
    assert np.mean(angles) == pytest.approx(PERTURBATIONS["normals_turned"].levels[severity - 1], rel=0.15)


@pytest.mark.parametrize(("severity", "share"), [(1, 0.5), (2, 0.9), (3, 1.0)])
def test_normals_are_absent_from_a_share_of_the_views(room: Scene, severity: int, share: float) -> None:
    absent = [view.normal is None for view in perturbed(room, "normals_absent", severity).train]
    assert np.mean(absent) == pytest.approx(share, abs=0.5 / len(absent))


def test_mirrored_normals_point_to_the_other_side_of_the_picture(room: Scene) -> None:
    for before, after in zip(room.train, perturbed(room, "normals_mirrored", 3).train, strict=True):
        old, new = (view.normal @ view.camera.world_to_camera[:3, :3].T for view in (before, after))
        assert torch.allclose(new, old * torch.tensor([-1.0, 1, 1]), atol=1e-5)
    mirrored = [
        not torch.equal(a.normal, b.normal)
        for a, b in zip(room.train, perturbed(room, "normals_mirrored", 1).train, strict=True)
    ]
    assert sum(mirrored) == round(0.25 * len(mirrored))


def test_normals_that_are_not_there_cannot_be_perturbed() -> None:
    with pytest.raises(DatasetError, match="gray has no normals for its training views"):
        perturbed(gray_scene(), "normals_turned", 1)


@pytest.mark.parametrize(("severity", "gray"), [(1, 0), (2, 128), (3, 255)])
def test_the_background_is_another_in_every_view_and_the_scene_says_so(
    toys: dict[str, Scene], severity: int, gray: int
) -> None:
    ball = toys["sky_ball"]
    changed = perturbed(ball, "background", severity)
    assert torch.allclose(255 * changed.background, torch.full((3,), float(gray)), atol=0.6)
    for before, after in zip([*ball.train, *ball.test], [*changed.train, *changed.test], strict=True):
        sky = before.depth == 0
        assert sky.any()
        assert (after.image[sky] == gray).all()
        assert torch.equal(after.image[~sky], before.image[~sky])
    distance = cKDTree(ball.points.numpy()).query(changed.points.numpy())[0]
    assert (distance == 0).all()
    far = ball.points.norm(dim=1) > 10  # those on the sky
    assert far.any()
    assert (changed.points.norm(dim=1) > 10).sum() < 0.1 * far.sum()


def test_a_background_that_is_unknown_or_unseen_is_not_replaced() -> None:
    with pytest.raises(DatasetError, match="view view1 has neither depths nor a mask of the region foreground"):
        perturbed(tiny_scene(), "background", 1)
    full = {"foreground": torch.ones(48, 48, dtype=torch.bool)}
    gray = gray_scene()
    covered = replace(
        gray, train=[replace(v, masks=full) for v in gray.train], test=[replace(gray.test[0], masks=full)]
    )
    with pytest.raises(DatasetError, match="shows no background in its training views"):
        perturbed(covered, "background", 1)


def test_a_foreground_mask_is_as_good_as_depths(toys: dict[str, Scene]) -> None:
    ball = toys["sky_ball"]
    views = {
        part: [replace(v, depth=None, masks={"foreground": v.depth > 0}) for v in getattr(ball, part)]
        for part in ("train", "test", "val")
    }
    by_mask = perturbed(replace(ball, **views), "background", 2)
    by_depth = perturbed(ball, "background", 2)
    assert all(torch.equal(a.image, b.image) for a, b in zip(by_mask.train, by_depth.train, strict=True))
    assert torch.equal(by_mask.points, by_depth.points)


@pytest.mark.parametrize(("kind", "sign"), [("masks_grown", 1), ("masks_shrunk", -1)])
@pytest.mark.parametrize(("severity", "pixels"), [(1, 1), (2, 2), (3, 4)])
def test_a_disk_of_a_mask_grows_or_shrinks_by_the_pixels(kind: str, sign: int, severity: int, pixels: int) -> None:
    """Along rows and columns: the taxicab distance to the mask decides, by SciPy's transform."""
    rows, columns = np.mgrid[:48, :48]
    disk = np.hypot(rows - 24, columns - 24) < 12
    scene = gray_scene()
    scene = replace(scene, test=[replace(scene.test[0], masks={"reflective": torch.from_numpy(disk)})])
    changed = perturbed(scene, kind, severity)
    outside = (
        ndimage.distance_transform_cdt(~disk, "taxicab")
        if sign > 0
        else ndimage.distance_transform_cdt(disk, "taxicab")
    )
    expected = outside <= pixels if sign > 0 else outside > pixels
    assert (changed.test[0].masks["reflective"].numpy() == expected).all()
    assert unchanged(scene, changed) == {"train", "points", "background"}
    assert torch.equal(changed.test[0].image, scene.test[0].image)
