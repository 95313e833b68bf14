"""The oracle's gradients against finite differences, and every backend's against closed forms."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import pytest
import torch
from core_scenes import (
    C0,
    ORACLE,
    Backend,
    facing_surfels,
    gradients_of,
    loss_of,
    plain_camera,
    random_rays,
    random_set,
    relative_error,
    tilted_camera,
)
from oracle import TOLERANCE
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering
from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.core.torch.sh import sh_color

BACKGROUND = torch.tensor([0.3, 0.9, 0.1])
NAMES = [f.name for f in fields(GaussianSet)]


def broad_set(columns: int = 2, degree: int = 1) -> GaussianSet:
    """Four wide Gaussians whose supports cover every ray and whose colors are positive: all is smooth. float64."""
    base = random_set(4, columns=columns, degree=degree, extras=1, seed=1).to(torch.float64)
    means = torch.tensor([[0.1, 0.0, 3.0], [-0.2, 0.1, 4.0], [0.2, -0.1, 5.0], [0.0, 0.2, 6.0]], dtype=torch.float64)
    tilt = torch.tensor([1.0, 0.15, -0.2, 0.1], dtype=torch.float64) + 0.05 * base.quaternions
    sh = torch.cat([torch.ones(4, 1, 3), 0.1 * base.sh[:, 1:]], dim=1).to(torch.float64)
    return replace(
        base, means=means, quaternions=tilt, scales=1 + base.scales, opacities=0.3 + base.opacities / 2, sh=sh
    )


def check_against_differences(render, inputs: list[Tensor]) -> None:
    def function(*values: Tensor) -> tuple[Tensor, ...]:
        drawn: Rendering = render(*values)
        assert (drawn.hits > 0).all()
        return drawn.color, drawn.alpha, drawn.depth, drawn.normal, drawn.extras

    leaves = [value.detach().clone().requires_grad_() for value in inputs]
    assert torch.autograd.gradcheck(function, leaves, eps=1e-6, atol=1e-6, rtol=1e-5, check_undefined_grad=False)


@pytest.mark.parametrize("columns", [2, 3], ids=["surfels", "gaussians_3d"])
@pytest.mark.parametrize("low_pass", [True, False], ids=["low-pass", "exact"])
def test_rasterized_gradients_are_differences(columns, low_pass):
    intrinsics = torch.tensor([[8.0, 0.5, 1.2], [0.0, 9.0, 1.1], [0.0, 0.0, 1.0]])
    camera = replace(tilted_camera(3, 2), intrinsics=intrinsics).to(torch.float64)

    def render(*values: Tensor) -> Rendering:
        return ORACLE.rasterize(GaussianSet(*values), camera, low_pass=low_pass, background=BACKGROUND)

    check_against_differences(render, list(vars(broad_set(columns)).values()))


def test_gradients_through_the_screen_space_filter_are_differences():
    """Surfels far smaller than a pixel are drawn by the filter alone."""
    camera = plain_camera(3, 3, focal=4.0).to(torch.float64)
    tiny = replace(broad_set(), scales=torch.full((4, 2), 1e-3, dtype=torch.float64))
    tiny = replace(tiny, means=tiny.means * torch.tensor([0.1, 0.1, 1.0], dtype=torch.float64))

    def render(*values: Tensor) -> Rendering:
        return ORACLE.rasterize(GaussianSet(*values), camera)

    check_against_differences(render, list(vars(tiny).values()))


@pytest.mark.parametrize(("degree", "sh_direction"), [(0, "center"), (1, "ray"), (2, "center"), (3, "ray")])
def test_traced_gradients_are_differences(degree, sh_direction):
    rays = [x.to(torch.float64) for x in plain_camera(2, 2, focal=6.0).rays()]
    origins = rays[0] + torch.tensor([0.1, -0.1, 0.2], dtype=torch.float64)

    def render(*values: Tensor) -> Rendering:
        return ORACLE.trace(GaussianSet(*values[:-2]), *values[-2:], background=BACKGROUND, sh_direction=sh_direction)

    check_against_differences(render, [*vars(broad_set(degree=degree)).values(), origins, rays[1]])


def one_ray(backend, gaussians: GaussianSet, background: Tensor | None = None, x: float = 0.3):
    leaves = backend.take(gaussians)
    origins, directions = backend.take(torch.tensor([[x, 0.0, 0.0]])), backend.take(torch.tensor([[0.0, 0.0, 1.0]]))
    return leaves, origins, directions, backend.trace(leaves, origins, directions, background=background)


def test_one_surfels_gradients_are_the_closed_forms(tracer):
    """A surfel at (0, 0, 3), σ = ½, hit at x = 0.3: α = o·exp(−x²/2σ²), c = α·g + (1 − α)·b."""
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, 3.0]]), scale=0.5, opacity=0.6)
    response = torch.tensor(-0.09 / 0.5).exp().item()
    leaves, origins, directions, drawn = one_ray(tracer, gaussians, background=torch.full((3,), 0.8))
    drawn.color[0, 0].backward()

    by_alpha = 0.1 - 0.8  # the surfel's gray before the background's, once
    assert leaves.opacities.grad.item() == pytest.approx(by_alpha * response, rel=1e-5)
    by_rho = by_alpha * -0.5 * 0.6 * response
    assert leaves.scales.grad[0].tolist() == pytest.approx([by_rho * -2 * 0.09 / 0.5**3, 0.0], rel=1e-4, abs=1e-7)
    by_x = by_rho * 2 * 0.3 / 0.25
    assert origins.grad[0].tolist() == pytest.approx([by_x, 0.0, 0.0], rel=1e-4, abs=1e-7)
    assert directions.grad[0].tolist() == pytest.approx([3 * by_x, 0.0, 0.0], rel=1e-4, abs=1e-7)
    assert leaves.means.grad[0].tolist() == pytest.approx([-by_x, 0.0, 0.0], rel=1e-4, abs=1e-7)
    assert leaves.sh.grad[0, 0].tolist() == pytest.approx([0.6 * response * C0, 0, 0], rel=1e-5, abs=1e-7)


def test_depths_gradient_along_the_ray_is_the_planes(tracer):
    """∂t/∂mean = n/(n·d), whatever the opacity."""
    gaussians = facing_surfels(torch.tensor([[0.0, 0.0, 3.0]]), opacity=0.6)
    leaves, origins, directions, drawn = one_ray(tracer, gaussians)
    drawn.depth[0].backward()
    assert leaves.means.grad[0].tolist() == pytest.approx([0.0, 0.0, 1.0], abs=1e-5)
    assert origins.grad[0].tolist() == pytest.approx([0.0, 0.0, -1.0], abs=1e-5)
    assert directions.grad[0].tolist() == pytest.approx([0.0, 0.0, -3.0], abs=1e-5)
    assert leaves.opacities.grad.item() == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("columns", [2, 3])
def test_a_clamped_alpha_passes_no_gradient_and_a_response_below_it_does(rasterizer, columns):
    gaussians = replace(
        facing_surfels(torch.tensor([[0.0, 0.0, 3.0]]), opacity=1.0), scales=torch.full((1, columns), 0.5)
    )
    camera = rasterizer.take(plain_camera())
    leaves = rasterizer.take(gaussians)
    rasterizer.rasterize(leaves, camera).alpha[16, 16].backward()
    assert leaves.opacities.grad.item() == 0
    assert not leaves.means.grad.any()

    leaves = rasterizer.take(gaussians)
    alpha = rasterizer.rasterize(leaves, camera).alpha[16, 20]
    alpha.backward()
    assert leaves.opacities.grad.item() == pytest.approx(alpha.item(), rel=1e-4)


def test_a_black_clamped_color_passes_no_gradient(tracer):
    gaussians = replace(facing_surfels(torch.tensor([[0.0, 0.0, 3.0]])), sh=torch.full((1, 1, 3), -3.0))
    leaves, *_, drawn = one_ray(tracer, gaussians)
    drawn.color.sum().backward()
    assert not leaves.sh.grad.any()
    assert not drawn.color.any()


def test_traced_position_gradients_are_each_rays_gradient_times_its_distance(tracer):
    """One ray at a time gives ∂L/∂mean of each hit; degree 0, so that all of it is geometry."""
    gaussians = replace(
        random_set(8, degree=0, seed=5), opacities=torch.full((8,), 0.5), scales=torch.full((8, 2), 1.0)
    )
    origins, directions = random_rays(12)
    leaves = tracer.take(gaussians)
    drawn = tracer.trace(leaves, tracer.take(origins), tracer.take(directions))
    assert drawn.statistics.position_gradients is None
    (drawn.color.sum() + drawn.normal.sum() + drawn.alpha.sum()).backward()

    expected = torch.zeros(8, 3, dtype=torch.float64)
    normals = rotation_matrices(gaussians.quaternions.double())[:, :, 2]
    for o, d in zip(origins, directions, strict=True):
        own = ORACLE.take(gaussians)
        alone = ORACLE.trace(own, ORACLE.take(o[None]), ORACLE.take(d[None]))
        (alone.color.sum() + alone.normal.sum() + alone.alpha.sum()).backward()
        t = ((gaussians.means - o).double() * normals).sum(1) / (normals @ d.double())
        assert own.means.grad is not None
        expected += t[:, None] * own.means.grad
    assert expected.abs().max() > 0.1
    torch.testing.assert_close(
        drawn.statistics.position_gradients.detach().cpu().double(), expected, atol=2e-3, rtol=1e-3
    )


def test_3d_gaussians_position_gradients_are_the_gradient_times_the_depth(rasterizer):
    """All hits on a 3D Gaussian share its center's depth."""
    gaussians, camera = random_set(30, columns=3, degree=0, seed=3), tilted_camera()
    leaves = rasterizer.take(gaussians)
    drawn = rasterizer.rasterize(leaves, rasterizer.take(camera))
    (drawn.color.sum() + drawn.alpha.sum()).backward()
    depths = camera.project(gaussians.means)[1].to(leaves.means)
    expected = depths[:, None] * leaves.means.grad
    torch.testing.assert_close(drawn.statistics.position_gradients, expected, atol=1e-2, rtol=1e-3)


@pytest.mark.parametrize("columns", [2, 3])
def test_position_gradients_leave_the_direction_of_color_out(rasterizer, columns):
    """The same picture with colors that don't depend on the direction gives the same position gradients."""
    gaussians, camera = random_set(40, columns=columns, degree=3, seed=2), tilted_camera()
    offsets = torch.nn.functional.normalize(gaussians.means.double() - camera.center.double(), dim=1)
    fixed = (sh_color(gaussians.sh.double(), offsets) - 0.5) / C0
    results = []
    for sh in (gaussians.sh, fixed[:, None, :].float()):
        leaves = rasterizer.take(replace(gaussians, sh=sh))
        drawn = rasterizer.rasterize(leaves, rasterizer.take(camera))
        loss_of(drawn).backward()
        results.append((drawn.statistics.position_gradients, leaves.means.grad))
    (positions, means), (fixed_positions, fixed_means) = results
    torch.testing.assert_close(positions, fixed_positions, atol=1e-2, rtol=1e-3)
    assert (means - fixed_means).norm() > 1e-2 * means.norm()


@pytest.mark.parametrize("columns", [2, 3], ids=["surfels", "gaussians_3d"])
def test_position_gradients_of_color_leave_out_what_else_is_drawn(rasterizer, columns):
    """Of a loss on all outputs they are those of its part on color; the set's gradients stay those of all of it."""
    gaussians, camera = random_set(30, columns=columns, seed=3), tilted_camera()

    def statistics(backend: Backend, color_alone: bool, **how: bool) -> tuple[Tensor, Tensor]:
        leaves = backend.take(gaussians)
        drawn = backend.rasterize(leaves, backend.take(camera), background=backend.take(BACKGROUND), **how)
        (drawn.color.square().sum() if color_alone else loss_of(drawn) + drawn.color.square().sum()).backward()
        assert drawn.statistics.position_gradients is not None
        return drawn.statistics.position_gradients.double().cpu(), leaves.means.grad

    everything, gradient = statistics(rasterizer, False)
    of_color, same_gradient = statistics(rasterizer, False, color_statistics=True)
    torch.testing.assert_close(same_gradient, gradient, rtol=1e-4, atol=1e-4)
    expected, _ = statistics(ORACLE, False, color_statistics=True)
    assert relative_error(of_color, expected) < TOLERANCE
    assert relative_error(of_color, everything) > 0.1


@pytest.mark.parametrize("columns", [2, 3], ids=["surfels", "gaussians_3d"])
def test_the_oracles_position_gradients_of_color_are_a_loss_on_color_alones(columns):
    gaussians, camera = random_set(30, columns=columns, seed=3), tilted_camera()
    found = []
    for color_alone in (True, False):
        leaves = ORACLE.take(gaussians)
        how = {"background": ORACLE.take(BACKGROUND), "color_statistics": not color_alone}
        drawn = ORACLE.rasterize(leaves, ORACLE.take(camera), **how)
        others = drawn.alpha.sum() + drawn.depth.sum() + drawn.normal.sum() + drawn.extras.sum()
        (drawn.color.square().sum() + (0 if color_alone else others)).backward()
        found.append(drawn.statistics.position_gradients)
    torch.testing.assert_close(*found)


@pytest.mark.parametrize("scale", [0.01, 0.05, 0.1])  # at some 13 pixels a unit: below the low-pass, about it, above
def test_position_gradients_without_the_low_pass_are_those_of_2dgs(rasterizer, scale):
    """Its program takes them from the projective transform, which the low-pass gives no gradient.

    It multiplies them by the depth of the center, ours are multiplied by that of each hit.
    """
    camera, surfels = plain_camera(), random_set(12, degree=0, extras=0, seed=4)
    per_pixel = torch.randn(camera.height, camera.width, generator=torch.Generator().manual_seed(0))
    answers = []
    for i in range(len(surfels)):
        own = {name: value[i : i + 1] for name, value in vars(surfels).items() if value is not None}
        surfel = GaussianSet(**{**own, "scales": torch.tensor([[scale, 0.7 * scale]])})
        gradients = []
        for counted in (False, True):
            leaves = rasterizer.take(surfel)
            drawn = rasterizer.rasterize(leaves, rasterizer.take(camera), low_pass_statistics=counted)
            (drawn.alpha * rasterizer.take(per_pixel)).sum().backward()
            gradients.append((drawn.statistics.position_gradients[0, :2].cpu().double(), leaves.means.grad))
        (without, means), (with_it, same_means) = gradients
        expected, answered = gradient_of_2dgs(surfel, camera, per_pixel)
        assert (without - expected).norm() < scale * expected.norm() + 1e-3
        assert bool((with_it - without).norm() > 1e-3) == answered
        torch.testing.assert_close(means, same_means, rtol=1e-4, atol=1e-4)
        answers.append(answered)
    assert any(answers) or scale == 0.1


def gradient_of_2dgs(surfel: GaussianSet, camera: Camera, per_pixel: Tensor) -> tuple[Tensor, bool]:
    """f·z·∂L/∂(its third column) of one surfel's projective transform for L = Σ per_pixel·alpha, from a camera at the
    origin; and whether the low-pass answers in any pixel. float64."""
    tangents = rotation_matrices(surfel.quaternions.double())[0, :, :2]
    columns = torch.cat([surfel.scales[0].double() * tangents, surfel.means[0].double()[:, None]], dim=1)
    transform = (camera.intrinsics.double() @ columns).requires_grad_()
    to_x, to_y, to_z = transform
    center = (transform[:2, 2] / transform[2, 2]).detach()
    rows, across = (torch.arange(n, dtype=torch.float64) + 0.5 for n in (camera.height, camera.width))
    pixel_y, pixel_x = torch.meshgrid(rows, across, indexing="ij")
    meeting = torch.linalg.cross(pixel_x[..., None] * to_z - to_x, pixel_y[..., None] * to_z - to_y)
    plane = (meeting[..., :2] / meeting[..., 2:]).square().sum(-1)
    screen = 2 * ((pixel_x - center[0]) ** 2 + (pixel_y - center[1]) ** 2)
    rho, opacity = torch.minimum(plane, screen), surfel.opacities[0].double()
    drawn = rho <= min(9.0, 2 * math.log(max(255 * float(opacity), 1)))
    alpha = (opacity * (-rho / 2).exp()).clamp_max(0.99)
    (alpha * drawn * per_pixel).sum().backward()
    assert transform.grad is not None
    gradient = camera.intrinsics[0, 0] * transform[2, 2] * transform.grad[:2, 2]
    return gradient.detach(), bool((drawn & (screen < plane)).any())


def test_color_along_the_ray_moves_the_direction_and_neither_origin_nor_center(tracer):
    """One ray and three surfels. Colors that are fixed at what the ray sees give all but the direction's gradient;
    the direction's is that of the surfels' colors, by autograd and with the weights that were blended."""
    gaussians = facing_surfels(torch.tensor([[0.1, 0.0, 3.0], [-0.2, 0.1, 4.0], [0.2, -0.1, 5.0]]))
    sh = 0.4 * torch.randn(3, 16, 3, generator=torch.Generator().manual_seed(3))
    direction = torch.tensor([0.05, 0.1, 1.3])
    fixed = (sh_color(sh.double(), direction.double()) - 0.5) / C0
    gradients = []
    for coefficients in (sh, fixed[:, None, :].float()):
        leaves = tracer.take(replace(gaussians, sh=coefficients))
        rays = tracer.take(torch.zeros(1, 3)), tracer.take(direction[None])
        drawn = tracer.trace(leaves, *rays, sh_direction="ray")
        assert drawn.hits.item() == 3
        loss_of(drawn).backward()
        gradients.append((drawn, gradients_of(leaves, origins=rays[0], directions=rays[1])))
    (drawn, seen), (_, geometry) = gradients
    for name in ("means", "quaternions", "scales", "opacities", "origins"):
        torch.testing.assert_close(seen[name], geometry[name], atol=1e-5, rtol=1e-4)

    free = direction.double().requires_grad_()
    upstream = torch.randn(1, 3, generator=torch.Generator().manual_seed(2000)).double()  # loss_of's for color
    weights = drawn.statistics.weights.detach().cpu().double()
    (upstream * (weights[:, None] * sh_color(sh.double(), free)).sum(0)).sum().backward()
    assert free.grad is not None
    assert free.grad.norm() > 0.05
    torch.testing.assert_close(seen["directions"] - geometry["directions"], free.grad[None], atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_ray_gradients_survive_every_sh_degree(tracer, degree):
    gaussians, rays = random_set(60, degree=degree, seed=11), random_rays(40)
    for loss in (lambda drawn: drawn.color.sum(), loss_of):
        leaves, (origins, directions) = tracer.take(gaussians), [tracer.take(x) for x in rays]
        loss(tracer.trace(leaves, origins, directions)).backward()
        for gradient in (origins.grad, directions.grad):
            assert gradient.isfinite().all()
            assert (gradient.norm(dim=1) > 1e-4).double().mean() > 0.5


def test_what_needs_no_gradient_gets_none(tracer):
    gaussians, (origins, directions) = random_set(30), random_rays(20)
    leaves = tracer.take(gaussians).map(Tensor.detach)
    directions = tracer.take(directions)
    drawn = tracer.trace(leaves, tracer.take(origins).detach(), directions)
    drawn.color.sum().backward()
    assert directions.grad.any()
    assert leaves.means.grad is None


def test_without_gradients_nothing_is_recorded(rasterizer):
    leaves = rasterizer.take(random_set(20))
    with torch.no_grad():
        drawn = rasterizer.rasterize(leaves, rasterizer.take(tilted_camera()))
    assert not drawn.color.requires_grad
    assert drawn.statistics.weights.any()
    assert not drawn.statistics.weights.requires_grad


def test_non_contiguous_inputs_give_the_same_picture_and_gradients(rasterizer):
    gaussians, camera = random_set(50, seed=6), rasterizer.take(tilted_camera())
    plain = rasterizer.take(gaussians)
    strided = gaussians.map(lambda x: rasterizer.take(torch.stack([x, x], dim=-1))[..., 0].detach().requires_grad_())
    assert not strided.means.is_contiguous()
    one, other = rasterizer.rasterize(plain, camera), rasterizer.rasterize(strided, camera)
    assert torch.equal(one.color, other.color)
    loss_of(one).backward()
    loss_of(other).backward()
    for name in NAMES:
        torch.testing.assert_close(getattr(plain, name).grad, getattr(strided, name).grad)


def test_expanded_and_strided_rays_give_the_same_picture(tracer):
    gaussians = tracer.take(random_set(50, seed=6))
    origin, (_, directions) = tracer.take(torch.tensor([0.1, 0.2, -1.0])), random_rays(30)
    strided = tracer.take(torch.stack([directions, directions], dim=-1))[..., 0]
    assert not strided.is_contiguous()
    drawn = tracer.trace(gaussians, origin.expand(30, 3), strided)
    plain = tracer.trace(gaussians, origin.repeat(30, 1), strided.contiguous())
    assert torch.equal(drawn.color, plain.color)
    drawn.color.sum().backward()
    assert origin.grad.any()
