"""The cube map's lookup against closed forms, finite differences and its own continuity across seams."""

import pytest
import torch
from torch import Tensor

from envgs_bench.methods.lighting.cubemap import layout_of, resized_cubemap, sample_cubemap, texel_directions


def smooth(directions: Tensor) -> Tensor:
    """A smooth color over the sphere, [..., 3]."""
    unit = torch.nn.functional.normalize(directions, dim=-1)
    x, y, z = unit.unbind(-1)
    return torch.stack([0.5 + 0.4 * x * y, 0.5 + 0.3 * z + 0.1 * x, 0.5 + 0.4 * y * y * z], dim=-1)


def random_directions(count: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.randn(count, 3, generator=torch.Generator().manual_seed(5), dtype=dtype)


def test_axes_show_the_opengl_faces_center():
    size = 3
    texels = torch.zeros(6, size, size, 1)
    texels[:, 1, 1, 0] = torch.arange(1.0, 7.0)
    axes = torch.tensor([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]).float()
    assert sample_cubemap(texels, 7 * axes, layout_of(size))[:, 0].tolist() == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("direction", "face", "column", "row"),
    [  # the table of the OpenGL specification: s = (sc/|ma| + 1)/2, t = (tc/|ma| + 1)/2
        ((2.0, 0.5, -1.0), 0, 0.75, 0.375),  # +x: sc = -z, tc = -y
        ((-2.0, 0.5, -1.0), 1, 0.25, 0.375),  # -x: sc = z, tc = -y
        ((0.5, 2.0, -1.0), 2, 0.625, 0.25),  # +y: sc = x, tc = z
        ((0.5, -2.0, -1.0), 3, 0.625, 0.75),  # -y: sc = x, tc = -z
        ((0.5, -1.0, 2.0), 4, 0.625, 0.75),  # +z: sc = x, tc = -y
        ((0.5, -1.0, -2.0), 5, 0.375, 0.75),  # -z: sc = -x, tc = -y
    ],
)
def test_faces_are_oriented_as_opengl(direction, face, column, row):
    size = 8
    texels = torch.zeros(6, size, size, 3, dtype=torch.float64)
    centers = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    texels[..., 0] = torch.arange(6)[:, None, None]
    texels[..., 1] = centers[None, None, :]
    texels[..., 2] = centers[None, :, None]
    found = sample_cubemap(texels, torch.tensor([direction], dtype=torch.float64), layout_of(size))[0]
    torch.testing.assert_close(found, torch.tensor([face, column, row], dtype=torch.float64))


def test_texel_directions_are_where_the_texels_are_read():
    texels = torch.rand(6, 5, 5, 2, dtype=torch.float64)
    found = sample_cubemap(texels, texel_directions(5).double().reshape(-1, 3), layout_of(5))
    torch.testing.assert_close(found, texels.reshape(-1, 2), atol=1e-6, rtol=0)


def test_a_smooth_function_is_approximated_to_second_order_within_a_face_and_to_first_across_seams():
    directions = random_directions(4000)
    sizes = directions.abs().sort(dim=1).values
    inside = sizes[:, 1] / sizes[:, 2] < 1 - 1 / 16
    errors = []
    for size in (16, 64):
        texels = smooth(texel_directions(size).double())
        error = (sample_cubemap(texels, directions, layout_of(size)) - smooth(directions)).abs().amax(1)
        errors.append((error[inside].max().item(), error[~inside].max().item()))
    assert errors[1][0] < 2e-4
    assert errors[0][0] / errors[1][0] == pytest.approx(16, rel=0.15)
    assert errors[1][1] < 1e-3
    assert errors[0][1] / errors[1][1] > 3.5


@pytest.mark.parametrize("size", [2, 7, 32])
def test_no_seam_between_faces(size):
    texels = torch.rand(6, size, size, 3, dtype=torch.float64)
    layout = layout_of(size)
    along = torch.linspace(-1, 1, 401, dtype=torch.float64)
    step = 1e-9
    for first in range(3):
        for sign in (1.0, -1.0):
            edge = torch.zeros(401, 3, dtype=torch.float64)
            edge[:, first], edge[:, (first + 1) % 3], edge[:, (first + 2) % 3] = 1.0, sign, along
            here, there = edge.clone(), edge.clone()
            here[:, first] += step
            there[:, (first + 1) % 3] += sign * step
            for side in (1.0, -1.0):
                a, b = sample_cubemap(texels, side * here, layout), sample_cubemap(texels, side * there, layout)
                torch.testing.assert_close(a, b, atol=1e-6, rtol=0)


def test_gradients_against_finite_differences():
    texels = torch.rand(6, 4, 4, 2, dtype=torch.float64, requires_grad=True)
    directions = random_directions(60).requires_grad_()
    assert torch.autograd.gradcheck(lambda t, d: sample_cubemap(t, d, layout_of(4)), (texels, directions))


def test_every_texel_borders_on_its_neighbors_in_space():
    size = 6
    directions = torch.nn.functional.normalize(texel_directions(size).double(), dim=-1).reshape(-1, 3)
    around = layout_of(size).around
    inside = around[:, 1:-1, 1:-1]
    for neighbors in (around[:, :-2, 1:-1], around[:, 2:, 1:-1], around[:, 1:-1, :-2], around[:, 1:-1, 2:]):
        cosine = (directions[inside] * directions[neighbors]).sum(-1)
        assert cosine.min() > torch.cos(torch.tensor(2.0 / size)).item()
        assert cosine.max() < 1 - 1e-4


def test_a_resized_map_shows_the_same():
    def smooth(d: torch.Tensor) -> torch.Tensor:
        d = torch.nn.functional.normalize(d, dim=-1)
        return torch.stack([(2 * d[..., 0]).sin(), d[..., 1] * d[..., 2], (3 * d[..., 2]).cos()], dim=-1)

    for size, larger in ((16, 32), (5, 13)):
        resized = resized_cubemap(smooth(texel_directions(size).double()), layout_of(size), larger)
        assert resized.shape == (6, larger, larger, 3)
        assert (
            resized - smooth(texel_directions(larger).double())
        ).abs().max() < 9 / size**2  # h²/8·f″ along either axis


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_what_is_not_a_number_is_looked_up_without_an_error(value: float):
    """A step replayed from a graph that lacked room shows NaN: an index made of it would end a GPU's run."""
    directions = random_directions(3)
    directions[1] = value
    found = sample_cubemap(torch.rand(6, 4, 4, 2, dtype=torch.float64), directions, layout_of(4))
    assert found.isnan().all(dim=1).tolist() == [False, True, False]
