"""Pose alignment: an offset that is known is found again, and nothing is made worse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from fakes.runs import records, run_job_here, set_environment
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, rasterize
from envgs_bench.stages.pose_alignment import ALIGNED, aligned_camera, moved

DISTANCE = 3.0


@pytest.fixture(scope="module")
def gaussians() -> GaussianSet:
    """A few hundred blobs of all colors, 2 to 4 from the camera."""
    random = torch.Generator().manual_seed(0)
    count = 400
    means = torch.rand(count, 3, generator=random) * torch.tensor([4.0, 3.0, 2.0]) + torch.tensor([-2.0, -1.5, 2.0])
    sh = torch.zeros(count, 1, 3)
    sh[:, 0] = torch.randn(count, 3, generator=random)
    return GaussianSet(
        means=means,
        scales=torch.rand(count, 3, generator=random) * 0.1 + 0.05,
        quaternions=torch.nn.functional.normalize(torch.randn(count, 4, generator=random), dim=1),
        opacities=torch.full((count,), 0.9),
        sh=sh,
    )


def camera(width: int = 96, height: int = 72) -> Camera:
    intrinsics = torch.tensor([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    return Camera(torch.eye(4), intrinsics, width, height)


def points_seen(pose: Camera, points: Tensor) -> Tensor:
    """[N, 2] pixels."""
    at = points @ pose.world_to_camera[:3, :3].T + pose.world_to_camera[:3, 3]
    seen = at @ pose.intrinsics.T
    return seen[:, :2] / seen[:, 2:]


@pytest.mark.parametrize(
    "offset",
    [(0.03, -0.02, 0.02, 0, 0, 0), (0, 0, 0, 0.1, -0.05, 0.08), (0.02, 0.03, -0.01, -0.06, 0.04, -0.05)],
    ids=["turned", "moved", "both"],
)
def test_a_known_offset_is_found_again(gaussians: GaussianSet, offset: tuple[float, ...]) -> None:
    """To a twentieth of a pixel, of two to four."""
    true = camera()
    wrong = moved(true, np.array(offset))
    photograph = rasterize(gaussians, true).color.clamp(0, 1)
    off = (points_seen(wrong, gaussians.means) - points_seen(true, gaussians.means)).norm(dim=1)
    assert off.mean() > 1.5
    found = aligned_camera(lambda at: rasterize(gaussians, at).color, wrong, photograph, DISTANCE)
    left = (points_seen(found, gaussians.means) - points_seen(true, gaussians.means)).norm(dim=1)
    assert left.mean() < 0.05


def test_a_camera_that_is_right_stays_and_one_that_nothing_helps_does_too(gaussians: GaussianSet) -> None:
    true = camera(48, 36)
    photograph = rasterize(gaussians, true).color.clamp(0, 1)
    kept = aligned_camera(lambda at: rasterize(gaussians, at).color, true, photograph, DISTANCE)
    assert (points_seen(kept, gaussians.means) - points_seen(true, gaussians.means)).norm(dim=1).max() < 1e-3
    flat = torch.full((36, 48, 3), 0.3)
    assert aligned_camera(lambda at: flat, true, photograph, DISTANCE) is true


def test_a_change_turns_about_the_center_and_moves_along_the_axes() -> None:
    """As the derivative says: what lies straight ahead at depth z goes by focal · (angle or shift / z)."""
    ahead = torch.tensor([[0.0, 0.0, 4.0]])
    at = camera()
    before = points_seen(at, ahead)
    turned = points_seen(moved(at, np.array([0, 1e-3, 0, 0, 0, 0])), ahead) - before
    shifted = points_seen(moved(at, np.array([0, 0, 0, 4e-3, 0, 0])), ahead) - before
    torch.testing.assert_close(turned, torch.tensor([[0.096, 0.0]]), atol=1e-4, rtol=0)
    torch.testing.assert_close(shifted, torch.tensor([[0.096, 0.0]]), atol=1e-4, rtol=0)
    twice = moved(moved(at, np.array([0.1, 0, 0.2, 0, 1, 0])), np.zeros(6))
    torch.testing.assert_close(twice.center.norm(), torch.tensor(1.0))


def test_runs_of_moved_cameras_have_both_and_others_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)
    perturbed = ("perturb.kind=pose_rotation", "perturb.severity=3")
    assert run_job_here(tmp_path / "runs", *perturbed) == 0
    assert run_job_here(tmp_path / "runs") == 0
    by_kind = {record.perturbation is not None: record.metrics for record in records(tmp_path / "runs")}
    plain, both = by_kind[False], by_kind[True]
    assert plain is not None
    assert both is not None
    assert ALIGNED not in plain.mean
    for view in both.per_view:
        psnr, aligned = view.scores["psnr"], view.scores[ALIGNED]
        assert psnr is not None
        assert aligned is not None
        assert aligned >= psnr - 1e-6
