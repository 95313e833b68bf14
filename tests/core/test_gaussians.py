"""GaussianSet and the two calls' arguments: what is refused, and how."""

from __future__ import annotations

import importlib
from dataclasses import replace

import pytest
import torch
from core_scenes import plain_camera, random_rays, random_set

from envgs_bench.core import Bvh, GaussianSet, available_backends, build_bvh, rasterize, trace


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("means", torch.zeros(4, 2), r"means has shape \(4, 2\)"),
        ("quaternions", torch.ones(4, 3), r"quaternions has shape \(4, 3\), expected one of \[\(4, 4\)\]"),
        ("scales", torch.ones(4, 4), r"scales has shape \(4, 4\)"),
        ("opacities", torch.ones(4, 1), r"opacities has shape \(4, 1\)"),
        ("opacities", torch.ones(5), r"opacities has shape \(5,\)"),
        ("sh", torch.ones(4, 5, 3), r"sh has shape \(4, 5, 3\)"),
        ("sh", torch.ones(4, 25, 3), r"sh has shape \(4, 25, 3\)"),
        ("extras", torch.ones(4, 9), r"extras has shape \(4, 9\)"),
        ("scales", torch.ones(4, 2, dtype=torch.float64), "scales is torch.float64 on cpu, but means is torch.float32"),
    ],
)
def test_wrong_shapes_and_dtypes_are_named(field, value, message):
    with pytest.raises(ValueError, match=message):
        replace(random_set(4), **{field: value})


@pytest.mark.parametrize("value", [torch.ones(4, dtype=torch.int64), [0.5] * 4])
def test_anything_but_floating_point_tensors_is_refused(value):
    with pytest.raises(TypeError, match=r"opacities must be a floating-point tensor"):
        replace(random_set(4), opacities=value)


@pytest.mark.parametrize(("coefficients", "degree"), [(1, 0), (4, 1), (9, 2), (16, 3)])
def test_sh_degree_follows_from_the_coefficients(coefficients, degree):
    gaussians = replace(random_set(4), sh=torch.zeros(4, coefficients, 3))
    assert gaussians.sh_degree == degree
    assert len(gaussians) == 4
    assert gaussians.is_surfels


def test_map_leaves_absent_extras_absent():
    gaussians = random_set(4, extras=0).map(lambda x: x[1:3])
    assert gaussians.extras is None
    assert len(gaussians) == 2


def test_unknown_backends_are_refused():
    gaussians, rays = random_set(3), random_rays(2)
    with pytest.raises(ValueError, match="unknown backend 'opengl', expected auto or one of"):
        rasterize(gaussians, plain_camera(), backend="opengl")
    with pytest.raises(ValueError, match="unknown backend 'opengl'"):
        trace(gaussians, *rays, backend="opengl")


def test_native_backends_refuse_other_dtypes_and_say_what_to_do():
    with pytest.raises(ValueError, match=r"takes float32 tensors on cpu, got torch\.float64 on cpu; convert them"):
        rasterize(random_set(3).to(torch.float64), plain_camera().to(torch.float64), backend="cpu")


def test_embree_does_not_rasterize():
    with pytest.raises(ValueError, match="backend 'embree' traces rays only"):
        rasterize(random_set(3), plain_camera(), backend="embree")


def test_3d_gaussians_cannot_be_traced():
    gaussians_3d = random_set(3, columns=3)
    with pytest.raises(ValueError, match=r"trace takes surfels \(scales \[N, 2\]\)"):
        trace(gaussians_3d, *random_rays(2), backend="torch")
    with pytest.raises(ValueError, match=r"trace takes surfels"):
        build_bvh(gaussians_3d, backend="torch")


@pytest.mark.parametrize("shapes", [((5, 3), (4, 3)), ((5, 2), (5, 2)), ((), ())])
def test_rays_of_wrong_shapes_are_refused(shapes):
    origins, directions = (torch.zeros(shape) for shape in shapes)
    with pytest.raises(ValueError, match="must share a shape"):
        trace(random_set(3), origins, directions, backend="torch")


def test_rays_of_another_dtype_are_refused():
    origins, directions = random_rays(2)
    with pytest.raises(ValueError, match=r"directions are torch.float64 on cpu, gaussians torch.float32"):
        trace(random_set(3), origins, directions.double(), backend="torch")


def test_an_unknown_direction_of_color_is_refused():
    with pytest.raises(ValueError, match="sh_direction is 'mean', expected center or ray"):
        trace(random_set(3), *random_rays(2), sh_direction="mean", backend="torch")


def test_background_of_a_wrong_shape_is_refused():
    with pytest.raises(ValueError, match=r"background has shape \(1, 3\), expected \(3,\)"):
        rasterize(random_set(3), plain_camera(), background=torch.ones(1, 3), backend="torch")


def test_a_bvh_over_another_set_is_refused(tracer):
    gaussians, rays = tracer.take(random_set(3)), [tracer.take(x) for x in random_rays(2)]
    stale = build_bvh(tracer.take(random_set(5)), backend=tracer.name)
    with pytest.raises(ValueError, match="built over 5 primitives, the set has 3: rebuild it"):
        tracer.trace(gaussians, *rays, bvh=stale)


def test_a_bvh_of_another_backend_is_refused(tracer):
    gaussians, rays = tracer.take(random_set(3)), [tracer.take(x) for x in random_rays(2)]
    foreign = Bvh(backend="elsewhere", primitives=3, handle=None)
    with pytest.raises(ValueError, match="elsewhere"):
        tracer.trace(gaussians, *rays, bvh=foreign)


def test_available_backends_says_why_not():
    reasons = available_backends()
    assert set(reasons) == {"cpu", "cuda", "torch", "embree"}
    assert reasons["torch"] is None
    assert all(reason is None or len(reason) > 10 for reason in reasons.values())


def test_a_backend_that_breaks_on_import_does_not_hide_the_others(monkeypatch):
    def broken(name: str):
        if name.endswith(".cuda"):
            raise OSError("libcuda.so.1: wrong ELF class")
        return importlib.__import__(name, fromlist=["why_unavailable"])

    monkeypatch.setattr("envgs_bench.core.backends.importlib.import_module", broken)
    reasons = available_backends()
    assert reasons["cuda"] == "cannot be imported: OSError: libcuda.so.1: wrong ELF class"
    assert reasons["torch"] is None


def test_a_set_may_be_empty_of_extras_columns():
    gaussians = GaussianSet(*(getattr(random_set(3), n) for n in ("means", "quaternions", "scales", "opacities", "sh")))
    drawn = rasterize(gaussians, plain_camera(5, 4), backend="torch")
    assert drawn.extras.shape == (4, 5, 0)
