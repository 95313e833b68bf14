"""L_norm and L_mono of a plane whose blended normals are half as long as unit ones."""

import math

import pytest
import torch
from reflection_scenes import HEIGHT, WIDTH, make_camera, mirror
from rules import with_rules

from envgs_bench.core import Camera, Rendering, Scene, View, depth_normals
from envgs_bench.methods.registry import create_method

NORMAL = torch.tensor([0.0, 0.0, -1.0])
TILTED = torch.tensor([0.0, math.sin(0.5), -math.cos(0.5)])  # what the view's own normals say


@pytest.fixture(autouse=True)
def _no_photometric_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("envgs_bench.methods.training.losses.photometric_loss", lambda *_, **__: torch.zeros(()))


def shown() -> Rendering:
    """The left half has alpha 0.4, the right half 0.9."""
    rendering = mirror(make_camera(), NORMAL, -4.0)
    rendering.alpha[:, : WIDTH // 2], rendering.alpha[:, WIDTH // 2 :] = 0.4, 0.9
    return rendering


def terms(step: int = 100, **settings) -> dict[str, float]:
    """The terms of the loss at that step of 100. L_mono counts ten times its weight in so short a run, and so 1."""
    plain = {"normal_weight": 1.0, "normal_from": 0, "normal_reference": "unit", "mono_weight": 0.1}
    method = create_method("2dgs", with_rules(**{**plain, **settings}))
    image = torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8)
    view = View("view", make_camera(), image, normal=TILTED.expand(HEIGHT, WIDTH, 3).clone())
    method.initialize(Scene("plane", [view], [], torch.rand(8, 3), torch.rand(8, 3)), 100)
    assert method.model.schedule.rate_scale == 10
    return {name: float(value) for name, value in method.losses(shown(), torch.zeros(1), view, step).items()}


def known_share() -> float:
    """Pixels to whose depth there is a normal."""
    return float(depth_normals(shown().depth, make_camera()).any(-1).float().mean())


def test_the_reference_of_l_norm_is_of_unit_length_or_as_long_as_alpha():
    assert terms()["normal"] == pytest.approx(known_share() * 0.5, rel=1e-4)
    reduced = 0.5 * (1 - 0.5 * 0.4) + 0.5 * (1 - 0.5 * 0.9)
    assert terms(normal_reference="alpha")["normal"] == pytest.approx(known_share() * reduced, rel=1e-4)


def test_l_norm_takes_normals_as_they_are_or_of_unit_length():
    assert terms(normal_rendered="unit")["normal"] == pytest.approx(0, abs=1e-5)


def fog_gradient(opacity: float, **settings: str) -> float:
    """∂L_norm/∂logit of a white surfel that fills the picture before a white background, faced head-on."""
    method = create_method("2dgs", with_rules(normal_from=0, initial_orientation="world", **settings))
    camera = Camera(torch.eye(4), torch.tensor([[20.0, 0, 10], [0, 20, 8], [0, 0, 1]]), WIDTH, HEIGHT)
    view = View("white", camera, torch.full((HEIGHT, WIDTH, 3), 255, dtype=torch.uint8))
    white = torch.ones(3)
    method.initialize(Scene("fog", [view], [], torch.tensor([[0.0, 0, 5]]), white[None], background=white), 100)
    surfel = method.model.sets["base"].parameters
    surfel.replace("opacity_logits", torch.logit(torch.tensor([opacity])))
    surfel.replace("log_scales", torch.full((1, 2), 5.0))
    rendering, _ = method.draw(camera, 1)
    method.losses(rendering, white.expand(HEIGHT, WIDTH, 3), view, 1)["normal"].backward()
    gradient = surfel.tensors["opacity_logits"].grad
    assert gradient is not None
    return float(gradient)


@pytest.mark.parametrize("opacity", [0.02, 0.1, 0.5])
def test_fog_before_the_background_gains_by_l_norm_in_proportion_to_what_it_hides(opacity):
    """A pixel of the background loses 1 − w without the factor, whatever w is: fog that no view sees would grow."""
    of_unit, of_alpha = (fog_gradient(opacity, normal_reference=reference) for reference in ("unit", "alpha"))
    assert of_unit < 0
    assert of_alpha == pytest.approx(opacity * of_unit, rel=1e-3)
    published, ours = create_method("2dgs").settings.rule, create_method("envgs").settings.rule
    assert (published.normal_reference, published.normal_rendered) == ("alpha", "blended")
    assert ours.normal_rendered == "unit"


@pytest.mark.parametrize("opacity", [0.02, 0.1, 0.5])
def test_normals_of_unit_length_leave_fog_alone(opacity):
    blended, of_unit = (
        fog_gradient(opacity, normal_reference="unit", normal_rendered=rendered) for rendered in ("blended", "unit")
    )
    assert abs(of_unit) < 1e-3 * abs(blended)


@pytest.mark.parametrize(("loss", "of_unit"), [("cos", 0.0), ("l1_cos", math.sin(0.5) + 1 - math.cos(0.5))])
def test_l_mono_takes_normals_as_they_are_or_of_unit_length(loss, of_unit):
    cosine = math.cos(0.5)
    found = terms(mono_loss=loss, mono_rendered="unit")["mono"]
    assert found == pytest.approx(1 - cosine + of_unit, rel=1e-4)
    blended = {"cos": 0.0, "l1_cos": math.sin(0.5) + cosine - 0.5}[loss]
    assert terms(mono_loss=loss)["mono"] == pytest.approx(1 - 0.5 * cosine + blended, rel=1e-4)


def test_both_losses_are_weighted_by_alpha():
    found = terms(normal_weighting="alpha", mono_rendered="unit")
    assert found["mono"] == pytest.approx((1 - math.cos(0.5)) * 0.65, rel=1e-4)
    known = depth_normals(shown().depth, make_camera()).any(-1)
    assert found["normal"] == pytest.approx(float((known * shown().alpha * 0.5).mean()), rel=1e-4)


def test_l_mono_starts_when_it_is_told_to():
    late = {"mono_from": 15_000}  # of 30,000: half of the run
    assert [("mono" in terms(step, **late)) for step in (1, 50, 51, 100)] == [False, False, True, True]
