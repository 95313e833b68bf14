"""Small scenes for the core's tests, and how two drawings of one are compared."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from envgs_bench.core import (
    Camera,
    GaussianSet,
    Rendering,
    depth_normals,
    rasterize,
    rasterize_color,
    reflect,
    trace,
    trace_color,
)
from envgs_bench.core.ssim import K1, K2, TAPS, ssim_map
from envgs_bench.core.torch.gaussians_3d import RasterizedGaussians3D
from envgs_bench.core.torch.intersections import MAX_ALPHA, Intersector, alphas
from envgs_bench.core.torch.search import all_blended_hits
from envgs_bench.core.torch.surfels import RasterizedSurfels, TracedSurfels
from envgs_bench.methods.training.optimizer import KernelAdam

FIELDS = ("color", "alpha", "depth", "normal", "extras")
C0 = 0.28209479177387814


@dataclass(frozen=True)
class Backend:
    """A backend, and the dtype and device it is tested with."""

    name: str
    dtype: torch.dtype
    device: str

    @staticmethod
    def named(name: str) -> Backend:
        native = name in ("cpu", "cuda")
        return Backend(name, torch.float32 if native else torch.float64, "cuda" if name == "cuda" else "cpu")

    @property
    def tolerance(self) -> float:
        return 2e-5 if self.dtype == torch.float32 else 1e-9

    def why_unavailable(self) -> str | None:
        return importlib.import_module(f"envgs_bench.core.{self.name}").why_unavailable()

    def take(self, value):
        """A set, camera or tensor as this backend wants it; a set or tensor becomes a leaf that wants gradients."""
        if isinstance(value, Camera):
            return value.to(self.device).to(self.dtype)
        if isinstance(value, GaussianSet):
            return value.map(self.take)
        return value.detach().to(self.device, self.dtype).requires_grad_()

    def rasterize(self, gaussians: GaussianSet, camera: Camera, **options) -> Rendering:
        return rasterize(gaussians, camera, backend=self.name, **options)

    @torch.no_grad()
    def rasterize_color(self, gaussians: GaussianSet, camera: Camera, **options) -> tuple[Tensor, Tensor]:
        return rasterize_color(gaussians, camera, backend=self.name, **options)

    def trace(self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, **options) -> Rendering:
        return trace(gaussians, origins, directions, backend=self.name, **options)

    @torch.no_grad()
    def trace_color(
        self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, **options
    ) -> tuple[Tensor, Tensor]:
        return trace_color(gaussians, origins, directions, backend=self.name, **options)


ORACLE = Backend.named("torch")


def random_set(count: int, *, columns: int = 2, degree: int = 2, extras: int = 1, seed: int = 0) -> GaussianSet:
    """Gaussians in a box of 4×3×4 around (0, 0, 4): about half a dozen deep, of all orientations. float32."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=generator)

    means = uniform(-1, 1, count, 3) * torch.tensor([2.0, 1.5, 2.0]) + torch.tensor([0.0, 0.0, 4.0])
    return GaussianSet(
        means=means,
        quaternions=torch.randn(count, 4, generator=generator),
        scales=uniform(0.05, 0.4, count, columns),
        opacities=uniform(0.0, 1.0, count),
        sh=uniform(-0.7, 0.7, count, (degree + 1) ** 2, 3),
        extras=uniform(0, 1, count, extras) if extras else None,
    )


def colored(colors: Tensor) -> Tensor:
    """Degree 0 coefficients [N, 1, 3] of colors [N, 3]."""
    return ((colors - 0.5) / C0)[:, None, :]


def dressed(gaussians: GaussianSet) -> GaussianSet:
    """With coefficients up to degree 2 and one extra, as random_set() has them."""
    missing = 9 - gaussians.sh.shape[1]
    sh = torch.nn.functional.pad(gaussians.sh, (0, 0, 0, missing))
    return replace(gaussians, sh=sh, extras=torch.rand(len(gaussians), 1, generator=torch.Generator().manual_seed(0)))


def facing_surfels(means: Tensor, scale: float = 0.5, opacity: float = 0.5) -> GaussianSet:
    """Surfels in planes of constant z, each of its own gray."""
    count = len(means)
    grays = torch.linspace(0.1, 0.9, max(count, 1))[:count, None].expand(-1, 3)
    return GaussianSet(
        means=means,
        quaternions=torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(count, 4),
        scales=torch.full((count, 2), scale),
        opacities=torch.full((count,), opacity),
        sh=colored(grays),
    )


def tilted_camera(width: int = 37, height: int = 29) -> Camera:
    """A camera near the origin that looks along +z, rotated about all axes, skewed, its principal point off center."""
    angle = torch.tensor([0.1, -0.15, 0.3], dtype=torch.float64)
    cross = torch.zeros(3, 3, dtype=torch.float64)
    cross[2, 1], cross[0, 2], cross[1, 0] = angle
    rotation = torch.linalg.matrix_exp(cross - cross.T)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = rotation
    pose[:3, 3] = torch.tensor([0.1, -0.2, 0.3])
    intrinsics = torch.tensor([[0.9 * width, 2.0, 0.4 * width], [0.0, 1.1 * width, 0.6 * height], [0.0, 0.0, 1.0]])
    return Camera(pose.float(), intrinsics, width, height)


def plain_camera(width: int = 33, height: int = 33, focal: float = 40.0) -> Camera:
    """A camera at the origin, along +z, whose middle pixel looks straight ahead where the size is odd."""
    intrinsics = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Camera(torch.eye(4), intrinsics, width, height)


def random_rays(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Rays from around the box of `random_set` toward points in it, directions of assorted lengths. float32."""
    generator = torch.Generator().manual_seed(seed + 1000)
    outward = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    middle = torch.tensor([0.0, 0.0, 4.0])
    targets = middle + 3 * (torch.rand(count, 3, generator=generator) - 0.5)
    origins = middle + 4.5 * outward
    lengths = 0.5 + torch.rand(count, 1, generator=generator)
    return origins, torch.nn.functional.normalize(targets - origins, dim=1) * lengths


def loss_of(rendering: Rendering, keep: Tensor | None = None, seed: int = 0) -> Tensor:
    """A fixed random linear function of every field, over the kept pixels or rays."""
    generator = torch.Generator().manual_seed(seed + 2000)
    total = torch.zeros((), dtype=rendering.alpha.dtype, device=rendering.alpha.device)
    for name in FIELDS:
        values = getattr(rendering, name)
        upstream = torch.randn(values.shape, generator=generator).to(values)
        if keep is not None:
            upstream = upstream * keep.to(values).reshape(keep.shape + (1,) * (values.ndim - keep.ndim))
        total = total + (upstream * values).sum()
    return total


def gradients_of(gaussians: GaussianSet, **rays: Tensor) -> dict[str, Tensor]:
    """The gradients a backward pass left, by field, in float64 on the CPU."""
    leaves = {f.name: getattr(gaussians, f.name) for f in fields(gaussians)} | rays
    return {
        name: (torch.zeros_like(leaf) if leaf.grad is None else leaf.grad).double().cpu()
        for name, leaf in leaves.items()
        if leaf is not None
    }


def relative_error(value: Tensor, reference: Tensor) -> float:
    """‖value − reference‖ / ‖reference‖, in float64; 0 where both are zero."""
    value, reference = value.detach().double().cpu(), reference.detach().double().cpu()
    difference = float((value - reference).norm())
    return difference / max(float(reference.norm()), 1e-30) if difference else 0.0


def traced(
    gaussians: GaussianSet, origins: Tensor, directions: Tensor, t_min: float = 0.0
) -> Callable[..., Intersector]:
    """How `steady` draws rays: a function of a set and a factor on t_min."""
    rays = origins.double().reshape(-1, 3), directions.double().reshape(-1, 3)
    return lambda changed, factor: TracedSurfels(changed, *rays, t_min * factor)


def rasterized(
    gaussians: GaussianSet, camera: Camera, near: float = 0.2, low_pass: bool = True
) -> Callable[..., Intersector]:
    """How `steady` draws an image: a function of a set and a factor on the near plane."""
    kind = RasterizedSurfels if gaussians.is_surfels else RasterizedGaussians3D
    return lambda changed, factor: kind(changed, camera, near=near * factor, low_pass=low_pass)


def steady(gaussians: GaussianSet, draw: Callable[..., Intersector], transmittance_min: float = 1e-4) -> Tensor:
    """Which rays blend the same hits in the same order when the scene is changed by about 1e-4.

    Supports end abruptly, hits are sorted, rays are ended by a threshold: on the other rays float32 and float64 may
    rightly differ by a whole hit, and no comparison of numbers means anything.
    """
    exact = gaussians.map(lambda x: x.detach().double())
    noise = torch.randn(exact.means.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    reference, same = None, None
    for size, shift, near, threshold in [
        (1, 0, 1, 1), (1 + 1e-4, 1e-5, 1, 1.002), (1 - 1e-4, -1e-5, 1, 0.998), (1, 2e-5, 1 + 1e-4, 1),
        (1, -2e-5, 1 - 1e-4, 1),
    ]:  # fmt: skip
        changed = GaussianSet(exact.means + shift * noise, exact.quaternions, exact.scales * size, exact.opacities,
                              exact.sh)  # fmt: skip
        outcome = hit_table(draw(changed, near), transmittance_min * threshold)
        if reference is None:
            reference, same = outcome, torch.ones(len(outcome), dtype=torch.bool)
        else:
            width = max(reference.shape[1], outcome.shape[1])
            same &= (padded(reference, width) == padded(outcome, width)).all(dim=1)
    assert same is not None
    return same.reshape(draw(exact, 1).shape)


def hit_table(intersector: Intersector, transmittance_min: float) -> Tensor:
    """For each ray a row of its hits, int64, padded with −1.

    A hit is which primitive, whether its alpha is clamped, and whether the low-pass filter moved it to the center.
    """
    hits = all_blended_hits(intersector, transmittance_min)
    means = intersector.gaussians.means[hits.primitives]
    intersections = intersector.intersect(hits.rays, hits.primitives, means)
    clamped = alphas(intersector.gaussians.opacities[hits.primitives], intersections.rho) >= MAX_ALPHA
    at_center = (
        (intersections.t == intersections.order)
        if isinstance(intersector, RasterizedSurfels)
        else torch.zeros_like(clamped)
    )
    codes = hits.primitives * 4 + clamped * 2 + at_center
    counts = torch.bincount(hits.rays, minlength=math.prod(intersector.shape))
    columns = torch.arange(len(codes)) - (counts.cumsum(0) - counts)[hits.rays]
    table = torch.full((len(counts), int(counts.max()) if len(counts) else 0), -1)
    table[hits.rays, columns] = codes
    return table


def padded(table: Tensor, width: int) -> Tensor:
    return torch.nn.functional.pad(table, (0, width - table.shape[1]), value=-1)


def assert_reflected_as_by_formula(
    kernel: Callable, image: Rendering, camera: Camera, beta_min: Tensor | float
) -> None:
    """The kernel's rays and their gradients are, at every pixel, those of the formula."""
    leaves = ("depth", "normal", "extras")
    image = replace(image, **{name: getattr(image, name).detach().clone().requires_grad_() for name in leaves})
    on_cpu = image.map(lambda x: x.detach().cpu().requires_grad_(x.requires_grad))
    rays = kernel(image, camera, 0.02, 1e-2, beta_min)
    if isinstance(beta_min, Tensor):
        beta_min = beta_min.cpu()
    expected = reflect(on_cpu, camera.to("cpu"), offset=0.02, beta_min=beta_min, backend="torch")
    for found in (rays, expected):
        generator = torch.Generator().manual_seed(0)
        sum((x * torch.randn(x.shape, generator=generator).to(x.device)).sum() for x in found).backward()
    for name in leaves:
        assert relative_error(getattr(image, name).grad, getattr(on_cpu, name).grad) < 1e-4, name
    origins, directions, beta = (x.detach().cpu() for x in rays)
    expected = [x.detach() for x in expected]
    reflects = expected[2] > 0
    assert 0 < reflects.sum() < reflects.numel()
    assert torch.equal(beta, expected[2])
    assert not directions[~reflects].any()
    torch.testing.assert_close(origins[reflects], expected[0][reflects], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(directions[reflects], expected[1][reflects], atol=1e-5, rtol=0)


def assert_depth_normals_as_by_formula(kernel: Callable, depth: Tensor, camera: Camera) -> None:
    """The kernel's normals and their gradient are, at every pixel, those of the formula."""
    depth = depth.detach().clone().requires_grad_()
    exact = depth.detach().cpu().double().requires_grad_()
    pose, intrinsics = (x.cpu().double() for x in (camera.world_to_camera, camera.intrinsics))
    on_cpu = Camera(pose, intrinsics, camera.width, camera.height)
    normals, expected = kernel(depth, camera), depth_normals(exact, on_cpu, backend="torch")
    known = expected.detach().any(-1)
    assert 0 < known.sum() < known.numel()
    torch.testing.assert_close(normals.detach().cpu().double(), expected.detach(), atol=1e-4, rtol=0)
    toward = torch.randn(expected.shape, generator=torch.Generator().manual_seed(0))
    (normals * toward.to(depth)).sum().backward()
    (expected * toward).sum().backward()
    assert relative_error(depth.grad, exact.grad) < 1e-4


def assert_similar_as_by_formula(kernel: Callable, device: str) -> None:
    """The kernel's similarity and its gradient are the formula's, on images smaller and larger than its tiles."""
    generator = torch.Generator().manual_seed(0)
    for height, width, padding in [
        (1, 1, "zero"),
        (40, 75, "zero"),
        (16, 32, "zero"),
        (27, 43, "valid"),
        (11, 11, "valid"),
    ]:
        planes, target = (torch.rand(*shape, generator=generator) for shape in ((3, height, width), (height, width, 3)))
        image = planes.to(device, copy=True).requires_grad_()
        exact = planes.double().requires_grad_()
        expected = ssim_map(exact.movedim(0, 2), target.double(), padding, backend="torch")
        found = kernel(image.movedim(0, 2), target.to(device), TAPS, 5 if padding == "zero" else 0, K1**2, K2**2)
        torch.testing.assert_close(found.detach().cpu().double(), expected.detach(), atol=2e-5, rtol=0)
        for values in (found, expected):  # a gradient in the other order of memory, and of one number
            toward = torch.rand(expected.shape, generator=torch.Generator().manual_seed(1)).to(values)
            ((values * toward).sum() + values.mean()).backward()
        assert relative_error(image.grad, exact.grad) < 1e-4


def assert_adam_is_torchs(device: str) -> None:
    """KernelAdam's steps against torch's own on the CPU: a skipped step, a rate that changes, a late gradient."""
    generator = torch.Generator().manual_seed(4)
    start = [torch.randn(shape, generator=generator) for shape in ((3,), (5, 3), (257, 9))]
    ours = [values.to(device, copy=True).requires_grad_() for values in start]
    theirs = [values.clone().requires_grad_() for values in start]
    rates = [torch.full((), 0.1, device=device) for _ in start]
    groups = [{"params": [values], "lr": rate} for values, rate in zip(ours, rates, strict=True)]
    one = KernelAdam(groups, eps=1e-15, capturable=True)
    other = torch.optim.Adam([{"params": [values], "lr": 0.1} for values in theirs], eps=1e-15)
    for step in range(6):
        for k, (mine, expected) in enumerate(zip(ours, theirs, strict=True)):
            if k == 1 and step < 2:
                continue  # a tensor that nothing was learned of has taken no step
            expected.grad = torch.randn(expected.shape, generator=generator) * 10.0 ** (-3 * k)
            mine.grad = expected.grad.to(device)
        if step == 4:
            rates[0].fill_(0.01)
            other.param_groups[0]["lr"] = 0.01
        skips = step == 3
        one.found_inf = torch.tensor(float(skips), device=device)
        one.step()
        if not skips:
            other.step()
    for mine, expected in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine.detach().cpu(), expected.detach(), rtol=2e-6, atol=2e-6)
