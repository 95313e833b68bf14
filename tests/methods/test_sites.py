"""Colors by sites: methods that have them, what they start from, and what files hold of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from envgs_bench.core import rasterize
from envgs_bench.core.torch.colors import site_color
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.parameters import activated
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage.ply import read_gaussians, write_ply
from envgs_bench.testing import check_method, tiny_scene

WITH_SITES: dict[str, dict[str, Any]] = {"2dgs": {}, "3dgs": {}, "envgs": {"env_grid": 2, "warm_up": 9_000}}


@pytest.mark.parametrize("kind", WITH_SITES)
def test_methods_with_sites_conform(kind: str) -> None:
    check_method(kind, WITH_SITES[kind] | {"color": "sites"})


def trained(kind: str = "2dgs", steps: int = 12, **settings: Any) -> GaussianMethod:
    method = create_method(kind, WITH_SITES[kind] | {"color": "sites"} | settings, "cpu", 0)
    assert isinstance(method, GaussianMethod)
    scene = tiny_scene()
    method.initialize(scene, steps)
    for step in range(1, steps + 1):
        method.training_step(scene.train[step % len(scene.train)], step)
    return method


def test_primitives_start_with_their_points_colors_from_every_side() -> None:
    scene, method = tiny_scene(), create_method("2dgs", {"color": "sites"}, "cpu", 0)
    method.initialize(scene, 30)
    gaussians = method.model.gaussians("base", 1)
    for direction in torch.eye(3):
        seen = site_color(gaussians.sh, direction.expand(len(gaussians), 3))
        torch.testing.assert_close(seen, scene.point_colors.float())
    lengths = gaussians.sh[..., 3:].norm(dim=-1)
    torch.testing.assert_close(lengths, torch.ones_like(lengths))
    assert gaussians.sh[0, :, 3:].sum(0).norm() < 0.5  # spread over the sphere


def test_both_sets_of_envgs_have_sites_and_their_bytes_are_counted() -> None:
    method = trained("envgs")
    assert set(method.model.sets) == {"base", "env"}
    for name, each in method.model.sets.items():
        assert each.parameters.gaussians().has_sites
        count = len(each.parameters)
        assert method.model_bytes()[name] == count * method.model.primitive_bytes()[name]
        colors = each.parameters.tensors["site_colors"]
        assert colors.abs().max() > 0  # learned


def test_a_ply_brings_the_picture_back_and_shows_others_the_constant_color(tmp_path: Path) -> None:
    method, camera = trained(), tiny_scene().test[0].camera
    tensors = method.model.sets["base"].parameters.detached()
    write_ply(tmp_path / "base.ply", tensors)
    again = rasterize(read_gaussians(tmp_path / "base.ply"), camera)
    assert torch.equal(again.color, rasterize(activated(tensors), camera).color)
    plain = {name: values for name, values in tensors.items() if not name.startswith("site_")}
    assert not torch.equal(again.color, rasterize(activated(plain), camera).color)


def test_a_method_with_a_color_of_its_own_refuses_sites() -> None:
    with pytest.raises(ValueError, match="color is 'sites', expected 'sh'"):
        create_method("3igs", {"color": "sites"}, "cpu", 0)
