"""All surfels that rays intersect, found by Embree."""

from __future__ import annotations

import numpy as np
import torch
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from torch import Tensor

from ..gaussians import GaussianSet
from ..torch.intersections import cutoffs
from ..torch.rotation import rotation_matrices

INFLATION = 1.001  # Embree works in float32: let it find a little more than the support
STEP_BACK = 1e-3  # rays start this far back, as a share of the scene: a surfel that a ray starts on is hit


@torch.no_grad()
def candidate_pairs(gaussians: GaussianSet, origins: Tensor, directions: Tensor, t_min: float) -> tuple[Tensor, Tensor]:
    """Indices of rays [P] and of surfels [P]: every hit with t ≥ t_min is among them, and hardly more.

    Embree returns only the closest hit, and a next cast that starts behind it would lose others at the same distance.
    So each question is a yes or no, does this ray hit any of these surfels, and a set that is hit is halved until it
    is a single surfel.
    """
    triangles, owners = support_triangles(gaussians)
    unit = torch.nn.functional.normalize(directions.double(), dim=1)
    reach = float(np.ptp(triangles.reshape(-1, 3), axis=0).max()) if len(owners) else 0.0
    start = (origins.double() + t_min * directions.double() - STEP_BACK * reach * unit).float().cpu().numpy()
    along = unit.float().cpu().numpy()

    device = EmbreeDevice()
    found: list[tuple[np.ndarray, np.ndarray]] = [(np.empty(0, np.int64), np.empty(0, np.int64))]
    pending = [(np.arange(len(owners)), np.arange(len(start)))]
    while pending:
        members, rays = pending.pop()
        if len(members) == 0 or len(rays) == 0:
            continue
        rays = rays[hit_any(device, triangles[members], start[rays], along[rays])]
        if len(members) == 1:
            found.append((rays, np.full(len(rays), owners[members[0]])))
        else:
            pending += [(half, rays) for half in halves(members, triangles)]
    pairs = [torch.from_numpy(np.concatenate(part)).to(origins.device) for part in zip(*found, strict=True)]
    return pairs[0], pairs[1]


def support_triangles(gaussians: GaussianSet) -> tuple[np.ndarray, np.ndarray]:
    """A triangle [M, 3, 3] around each visible surfel's support, float32, and the surfels' indices [M].

    One triangle and not a quad of two: no ray can slip through a seam, and no surfel is found twice.
    """
    radii = cutoffs(gaussians.opacities).clamp_min(0).sqrt() * INFLATION
    visible = torch.nonzero(gaussians.opacities > 0)[:, 0]
    visible = visible[radii[visible] > 0]
    angles = torch.arange(3, device=gaussians.device) * (2 * torch.pi / 3)
    corners = 2 * torch.stack([angles.cos(), angles.sin()], dim=-1).to(radii)  # [3, 2], around the unit circle
    extents = (radii[:, None] * gaussians.scales)[visible]
    axes = rotation_matrices(gaussians.quaternions)[visible][:, :, :2] * extents[:, None, :]
    triangles = gaussians.means[visible][:, None, :] + corners @ axes.mT
    return triangles.float().cpu().numpy(), visible.cpu().numpy()


def hit_any(device: EmbreeDevice, triangles: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Which rays hit any of the triangles, [R] bool."""
    scene = EmbreeScene(device)
    mesh = TriangleMesh(scene, np.ascontiguousarray(triangles))  # the scene reads it while it is cast against
    hit: np.ndarray = scene.run(np.ascontiguousarray(origins), np.ascontiguousarray(directions)) >= 0
    del mesh
    return hit


def halves(members: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A set of triangles in two, cut where its centers spread the most, so that most rays hit but one half."""
    centers = triangles[members].mean(axis=1)
    along = centers[:, np.ptp(centers, axis=0).argmax()]
    order = members[along.argsort(kind="stable")]
    return order[: len(order) // 2], order[len(order) // 2 :]
