"""Camera: projection, rays, resizing and checks, against pycolmap and written-out formulas."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
import torch
from core_scenes import plain_camera, tilted_camera
from scipy.spatial.transform import Rotation

from envgs_bench.core import Camera


def test_project_agrees_with_pycolmap():
    camera = tilted_camera()
    k = camera.intrinsics.clone()
    k[0, 1] = 0  # COLMAP's cameras have no skew
    camera = Camera(camera.world_to_camera, k, camera.width, camera.height)
    colmap = pycolmap.Camera(
        model="PINHOLE",
        width=camera.width,
        height=camera.height,
        params=[float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])],
    )
    pose = pycolmap.Rigid3d(camera.world_to_camera[:3].double().numpy())
    points = np.random.default_rng(0).uniform([-1, -1, 3], [1, 1, 5], (50, 3))

    pixels, depths = camera.project(torch.from_numpy(points).float())

    in_camera = np.array([pose * p for p in points])
    np.testing.assert_allclose(depths.numpy(), in_camera[:, 2], rtol=1e-5)
    np.testing.assert_allclose(pixels.numpy(), np.array(colmap.img_from_cam(in_camera)), rtol=1e-4)


def test_project_with_skew_is_the_written_out_formula():
    camera = tilted_camera()
    point = np.array([0.4, -0.3, 3.0])
    x, y, z = camera.world_to_camera.numpy()[:3, :3] @ point + camera.world_to_camera.numpy()[:3, 3]
    k = camera.intrinsics.numpy()

    pixel, depth = camera.project(torch.tensor(point, dtype=torch.float32))

    expected = [k[0, 0] * x / z + k[0, 1] * y / z + k[0, 2], k[1, 1] * y / z + k[1, 2]]
    np.testing.assert_allclose(pixel.numpy(), expected, rtol=1e-5)
    assert depth.item() == pytest.approx(z, rel=1e-6)


def test_rays_pass_through_pixel_centers_at_unit_depth():
    camera = tilted_camera(7, 5)
    origins, directions = camera.rays()
    assert origins.shape == directions.shape == (5, 7, 3)

    pixels, depths = camera.project(origins + 2.5 * directions)

    rows, columns = torch.meshgrid(torch.arange(5.0), torch.arange(7.0), indexing="ij")
    torch.testing.assert_close(pixels, torch.stack([columns, rows], -1) + 0.5, atol=1e-4, rtol=0)
    torch.testing.assert_close(depths, torch.full((5, 7), 2.5), atol=1e-5, rtol=0)


def test_center_is_the_point_the_pose_maps_to_zero():
    camera = tilted_camera()
    rotation = Rotation.from_matrix(camera.world_to_camera[:3, :3].double().numpy())
    expected = rotation.inv().apply(-camera.world_to_camera[:3, 3].double().numpy())
    np.testing.assert_allclose(camera.center.numpy(), expected, atol=1e-6)


def test_resized_sees_the_same_points_at_scaled_positions():
    camera = tilted_camera(36, 28)
    points = torch.tensor([[0.1, 0.2, 3.0], [-0.4, 0.3, 5.0]])
    small = camera.resized(18, 7)
    assert (small.width, small.height) == (18, 7)
    torch.testing.assert_close(small.project(points)[0], camera.project(points)[0] * torch.tensor([0.5, 0.25]))


def rounded_pose(decimals: int) -> torch.Tensor:
    return tilted_camera().world_to_camera.double().round(decimals=decimals).float()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"world_to_camera": torch.eye(3)}, r"world_to_camera has shape \(3, 3\), expected \(4, 4\)"),
        ({"intrinsics": torch.eye(4)}, r"intrinsics has shape \(4, 4\), expected \(3, 3\)"),
        ({"width": 0}, "0×33 pixels, expected at least 1×1"),
        ({"world_to_camera": torch.full((4, 4), torch.nan)}, "not finite"),
        ({"world_to_camera": torch.diag(torch.tensor([2.0, 1.0, 1.0, 1.0]))}, "not a rotation"),
        ({"intrinsics": torch.diag(torch.tensor([-1.0, 1.0, 1.0]))}, "positive focal lengths"),
        ({"intrinsics": torch.diag(torch.tensor([1.0, 1.0, 2.0]))}, r"last row of \(0, 0, 1\)"),
        ({"intrinsics": torch.tensor([[9.0, 0, 4], [0.1, 9, 4], [0, 0, 1]])}, "0 below them"),
        ({"world_to_camera": rounded_pose(3)}, r"not a rotation: .* differs from the unit matrix by .* at most 1e-05"),
    ],
)
def test_bad_cameras_are_refused_with_the_reason(change, message):
    good = plain_camera()
    values = {"world_to_camera": good.world_to_camera, "intrinsics": good.intrinsics, "width": 33, "height": 33}
    with pytest.raises(ValueError, match=message):
        Camera(**(values | change))


def test_mirrored_poses_are_refused():
    with pytest.raises(ValueError, match="not a rotation"):
        Camera(torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0])), torch.eye(3), 4, 4)


def test_a_pose_of_six_decimals_shows_what_its_rays_hit():
    """To a hundredth of a pixel at a focal length of 1,000. One of three decimals, which is refused, misses by half."""
    intrinsics = torch.tensor([[1000.0, 0, 400], [0, 1000, 300], [0, 0, 1]])
    camera = Camera(rounded_pose(6), intrinsics, 800, 600).to(torch.float64)
    origins, directions = camera.rays()
    pixels, _ = camera.project(origins + 3 * directions)
    rows, columns = torch.meshgrid(torch.arange(600.0), torch.arange(800.0), indexing="ij")
    assert (pixels - torch.stack([columns, rows], -1) - 0.5).abs().max() < 0.01


def test_what_follows_from_a_checked_camera_is_not_checked_again(monkeypatch):
    """A check of values waits for a GPU that holds them; sizes are known without it."""
    camera = tilted_camera()

    def refuse(_: Camera) -> None:
        raise AssertionError("checked again")

    monkeypatch.setattr(Camera, "__post_init__", refuse)
    copies = camera.to(torch.float64), camera.to("cpu"), camera.resized(18, 7), camera.clone()
    assert [c.width for c in copies] == [37, 37, 18, 37]
    assert copies[0].intrinsics.dtype == torch.float64
    assert copies[3].world_to_camera.data_ptr() != camera.world_to_camera.data_ptr()
    with pytest.raises(ValueError, match="0×7 pixels"):
        camera.resized(0, 7)
