"""Data sets of somebody else's: one that is there at once, one with a real point cloud and no photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from envgs_bench.core import Camera, GaussianSet, Scene, View, rasterize
from envgs_bench.testing import tiny_scene


def tiny(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """The tiny scene, two views of it for testing, one region on the left half of the first."""
    scene = tiny_scene()
    left = torch.zeros(scene.test[0].image.shape[:2], dtype=torch.bool)
    left[:, : left.shape[1] // 2] = True
    masked = replace(scene.test[0], masks={"reflective": left})
    return replace(scene, name=settings["name"], train=scene.train[1:], test=[masked, scene.train[0]])


def tiny_elsewhere(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """As `tiny`, with other test views, and with one training view."""
    scene = tiny(settings, cache_dir)
    return replace(scene, name="elsewhere", train=scene.test[:1], test=scene.train)


def garden(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """gsplat's test_garden.npz: a structure-from-motion cloud and three cameras; pictures are drawn from the cloud."""
    from scipy.spatial import cKDTree

    with np.load(Path(settings["root"]) / "test_garden.npz") as data:
        content = {name: torch.from_numpy(np.asarray(data[name])) for name in data.files}
    points, colors = content["means3d"].float(), content["colors"].float() / 255
    spacing = torch.from_numpy(cKDTree(points.numpy()).query(points.numpy(), k=4)[0][:, 1:]).float().mean(dim=1)
    cloud = GaussianSet(
        means=points,
        quaternions=torch.tensor([1.0, 0, 0, 0]).repeat(len(points), 1),
        scales=spacing.clamp(1e-4, 0.05)[:, None].repeat(1, 3),
        opacities=torch.full((len(points),), 0.8),
        sh=((colors - 0.5) / 0.28209479)[:, None],
    )
    views = []
    for index, (pose, intrinsics) in enumerate(zip(content["viewmats"], content["Ks"], strict=True)):
        full = torch.cat([pose.float(), torch.tensor([[0.0, 0, 0, 1]])]) if len(pose) == 3 else pose.float()
        camera = Camera(full, intrinsics.float(), int(content["width"]), int(content["height"]))
        small = camera.resized(*(round(length / settings["downsample"]) for length in (camera.width, camera.height)))
        image = (255 * rasterize(cloud, small).color.clamp(0, 1)).round().byte()
        views.append(View(f"{index}", small, image))
    return Scene("garden", views[1:], views[:1], points, colors)
