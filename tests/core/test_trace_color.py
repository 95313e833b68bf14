"""trace_color: what trace draws, in color and alpha alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from core_scenes import Backend, colored, facing_surfels, random_rays, random_set

from envgs_bench.core import build_bvh, trace_color


def tolerance(tracer: Backend) -> float:
    return 5e-4 if tracer.name == "cuda" else 0.0  # SH coefficients in half precision


def taken(tracer: Backend, *values):
    return [tracer.take(value) for value in values]


@pytest.mark.parametrize("sh_direction", ["center", "ray"])
@pytest.mark.parametrize(("degree", "extras"), [(0, 0), (1, 2), (2, 1), (3, 8)])
def test_color_and_alpha_are_those_of_trace(tracer, degree, extras, sh_direction):
    inputs = taken(tracer, random_set(200, degree=degree, extras=extras), *random_rays(100))
    background = torch.tensor([0.7, 0.2, 0.4], device=tracer.device)
    options = {"background": background, "t_min": 0.5, "transmittance_min": 1e-2, "sh_direction": sh_direction}
    color, alpha = tracer.trace_color(*inputs, **options)
    expected = tracer.trace(*inputs, **options)
    torch.testing.assert_close(color, expected.color.detach(), atol=tolerance(tracer), rtol=0)
    torch.testing.assert_close(alpha, expected.alpha.detach(), atol=1e-6, rtol=0)  # two compilations round differently
    assert not color.requires_grad


@pytest.mark.parametrize("shape", [(0,), (1,), (3, 5), (2, 0, 4), ()])
def test_rays_of_any_leading_shape(tracer, shape):
    origins, directions = (x[: int(np.prod(shape))].reshape(*shape, 3) for x in random_rays(15))
    color, alpha = tracer.trace_color(*taken(tracer, random_set(50), origins, directions))
    assert color.shape == (*shape, 3)
    assert alpha.shape == shape


def test_an_empty_set_is_background(tracer):
    background = torch.tensor([0.2, 0.4, 0.8], device=tracer.device)
    inputs = taken(tracer, random_set(0, extras=0), *random_rays(7))
    color, alpha = tracer.trace_color(*inputs, background=background)
    torch.testing.assert_close(color.float(), background.expand(7, 3))
    assert not alpha.any()


def test_a_shared_bvh_changes_nothing(tracer):
    inputs = taken(tracer, random_set(300), *random_rays(100))
    own = tracer.trace_color(*inputs)
    shared = tracer.trace_color(*inputs, bvh=build_bvh(inputs[0], backend=tracer.name))
    for one, other in zip(own, shared, strict=True):
        assert torch.equal(one, other)


def test_a_foreign_bvh_is_refused(native):
    inputs = taken(native, random_set(9), *random_rays(3))
    bvh = build_bvh(random_set(9).to(torch.float64), backend="torch")
    with pytest.raises(ValueError, match=rf"built by backend 'torch', this is '{native.name}'"):
        native.trace_color(*inputs, bvh=bvh)


@pytest.mark.parametrize("wants", [0, 1, 2])
def test_gradients_are_refused(tracer, wants):
    inputs = taken(tracer, random_set(9), *random_rays(3))
    inputs = [x if k == wants else detached(x) for k, x in enumerate(inputs)]
    with pytest.raises(ValueError, match=r"trace_color has no gradients: call it within torch.no_grad\(\)"):
        trace_color(*inputs, backend=tracer.name)
    color, _ = trace_color(*map(detached, inputs), backend=tracer.name)
    assert not color.requires_grad


def detached(value):
    return value.detach() if isinstance(value, torch.Tensor) else value.map(torch.Tensor.detach)


@pytest.mark.parametrize("gray", [1e6, -1e6, torch.nan])
def test_what_no_half_can_hold_stays_finite_and_what_is_no_number_stays_that(native, gray):
    surfels = facing_surfels(torch.tensor([[0.0, 0.0, 2.0]]))
    surfels = replace(surfels, sh=colored(torch.full((1, 3), gray)))
    color, _ = native.trace_color(*taken(native, surfels, torch.zeros(1, 3), torch.tensor([[0.0, 0.0, 1.0]])))
    if gray > 0:
        assert 9e3 < float(color.max()) < 1e6
    else:
        assert torch.equal(color.isnan(), torch.full((1, 3), gray != gray, device=color.device))
        assert not color.nan_to_num().any()
