"""reflect(): rays at a planar mirror, and what does not reflect, in closed form."""

import pytest
import torch
from reflection_scenes import HEIGHT, WIDTH, make_camera, make_rendering, mirror
from torch import Tensor

from envgs_bench.core import Camera, reflect


def test_a_planar_mirror_shows_the_virtual_camera():
    """Every reflected ray, prolonged backward, passes through the camera's mirror image."""
    camera = make_camera()
    normal = torch.nn.functional.normalize(torch.tensor([0.3, -0.2, -1.0]), dim=0)
    distance = float(normal @ (camera.center + 3 * camera.rays()[1][8, 10]))
    origins, directions, beta = reflect(mirror(camera, normal, distance), camera)
    image_center = camera.center - 2 * (camera.center @ normal - distance) * normal
    expected = torch.nn.functional.normalize(origins - image_center, dim=-1)
    torch.testing.assert_close(origins @ normal, torch.full((HEIGHT, WIDTH), distance))
    torch.testing.assert_close(directions, expected, atol=1e-5, rtol=0)
    assert torch.equal(beta, torch.full((HEIGHT, WIDTH), 0.5))


def test_rays_start_above_the_surface():
    camera = make_camera()
    normal = torch.tensor([0.0, 0.0, -1.0])
    shown = mirror(camera, normal, -4.0)
    on, above = (reflect(shown, camera, offset=offset)[0] for offset in (0.0, 0.25))
    torch.testing.assert_close(above - on, 0.25 * normal.expand(HEIGHT, WIDTH, 3))


@pytest.mark.parametrize(
    ("beta_min", "dark"), [(0.0, [1, 2]), (1 / 255, [1, 2, 3]), (torch.tensor([0.01]), [1, 2, 3, 4])]
)
def test_only_surfaces_reflect_and_only_where_it_is_visible(beta_min, dark):
    camera = make_camera()
    shown = mirror(camera, torch.tensor([0.0, 0.0, -1.0]), -4.0)
    shown.alpha[0, 1] = 0.0
    shown.normal = shown.normal.clone()
    shown.normal[0, 2] = 1e-4
    shown.extras[0, 3], shown.extras[0, 4] = 0.003, 0.009
    _, directions, beta = reflect(shown, camera, beta_min=beta_min)
    reflects = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    reflects[0, dark] = False
    assert torch.equal(directions.any(-1), reflects)
    assert torch.equal(beta, shown.extras[..., 0] * reflects)


def test_gradients_against_finite_differences():
    """A mirror with a hole, whose directions and β have no gradient."""
    camera = make_camera()
    camera = Camera(camera.world_to_camera.double(), camera.intrinsics.double(), WIDTH, HEIGHT)
    shown = mirror(camera, torch.tensor([0.1, 0.0, -1.0], dtype=torch.float64), -4.0)
    alpha = torch.ones(HEIGHT, WIDTH, dtype=torch.float64)
    alpha[5:8] = 0.0

    def rays(depth: Tensor, normal: Tensor, beta: Tensor) -> tuple[Tensor, ...]:
        image = make_rendering(depth, normal, alpha, beta)
        return reflect(image, camera, offset=0.1, backend="torch")

    beta = torch.rand(HEIGHT, WIDTH, dtype=torch.float64) + 0.1
    inputs = [x.detach().clone().requires_grad_() for x in (shown.depth, shown.normal, beta)]
    assert torch.autograd.gradcheck(rays, inputs, fast_mode=True)
    _, directions, weights = rays(*inputs)
    (directions.sum() + weights.sum()).backward()
    for values in inputs[1:]:
        assert values.grad is not None
        assert values.grad.isfinite().all()
        assert not values.grad[5:8].any()
        assert values.grad[:5].any()


def test_where_nothing_is_drawn_gradients_are_finite():
    """Alpha, depth and normal 0, as behind all surfels: no 0/0 on the way back."""
    camera = make_camera()
    blank = torch.zeros(HEIGHT, WIDTH)
    leaves = [blank.clone().requires_grad_(), torch.zeros(HEIGHT, WIDTH, 3, requires_grad=True)]
    origins, directions, beta = reflect(make_rendering(leaves[0], leaves[1], blank, blank), camera, offset=0.1)
    (origins.sum() + directions.sum() + beta.sum()).backward()
    assert not directions.any()
    assert all(leaf.grad is not None and leaf.grad.isfinite().all() for leaf in leaves)
