"""Clone, split, prune and cap on sets whose outcome can be counted by hand."""

import dataclasses
import math

import pytest
import torch

from envgs_bench.core import Camera, Statistics
from envgs_bench.methods.gaussians.densification import (
    DensificationRecord,
    DensificationRule,
    camera_criterion,
    densify,
    screen_criterion,
    spatial_criterion,
)
from envgs_bench.methods.gaussians.parameters import GaussianParameters, LearningRates

RULE = DensificationRule(gradient_threshold=1.0, min_opacity=0.05, max_primitives=1000)
RADIUS = 1.0


def make_parameters(scales, opacities, axes: int = 2) -> GaussianParameters:
    """Primitives at (i, 0, 0), unturned, color i."""
    n = len(scales)
    index = torch.arange(n, dtype=torch.float32)
    tensors = {
        "means": torch.stack([index, torch.zeros(n), torch.zeros(n)], dim=1),
        "quaternions": torch.tensor([1.0, 0, 0, 0]).repeat(n, 1),
        "log_scales": torch.tensor(scales).log()[:, None].repeat(1, axes),
        "opacity_logits": torch.logit(torch.tensor(opacities)),
        "sh_dc": index[:, None, None].repeat(1, 1, 3),
        "sh_rest": torch.zeros(n, 8, 3),
    }
    return GaussianParameters(tensors, LearningRates(), RADIUS)


def make_record(gradients, weights) -> DensificationRecord:
    record = DensificationRecord(len(gradients), torch.device("cpu"))
    record.add(torch.tensor(gradients), torch.tensor(weights))
    return record


def colors(parameters: GaussianParameters) -> list[float]:
    return sorted(parameters.tensors["sh_dc"][:, 0, 0].tolist())


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_small_ones_are_cloned_large_ones_split_in_two():
    parameters = make_parameters([0.005, 0.005, 0.05, 0.05] + [0.005] * 16, [0.5] * 20)
    record = densify(parameters, make_record([2.0, 0.5, 2.0, 0.5] + [0.0] * 16, [1.0] * 20), RULE, RADIUS, generator())
    assert colors(parameters) == [0, 0, 1, 2, 2, *range(3, 20)]
    of_second = parameters.tensors["sh_dc"][:, 0, 0] == 2
    halves = parameters.tensors["log_scales"][of_second].exp()
    torch.testing.assert_close(halves, torch.full((2, 2), 0.05 / 1.6))
    moved = parameters.tensors["means"][of_second].detach() - torch.tensor([2.0, 0, 0])
    assert moved[:, :2].abs().min() > 0
    assert not moved[:, 2].any()  # a surfel's parts stay in its plane
    clones = parameters.tensors["means"][parameters.tensors["sh_dc"][:, 0, 0] == 0]
    assert torch.equal(clones[0], clones[1])
    assert len(record.weights) == len(parameters) == 22
    assert not record.gradients.any()


def test_the_parts_of_a_split_are_drawn_from_its_gaussian():
    n = 4000
    parameters = make_parameters([0.05] * n, [0.5] * n, axes=3)
    turn = torch.tensor([math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4)])  # x to y
    parameters.replace("quaternions", turn.repeat(n, 1))
    parameters.replace("log_scales", torch.tensor([0.08, 0.04, 0.02]).log().repeat(n, 1))
    densify(parameters, make_record([2.0] * n, [1.0] * n), DensificationRule(1.0, 0.05, 10 * n), RADIUS, generator())
    parts = parameters.tensors["log_scales"][:, 0] < math.log(0.07)
    offsets = parameters.tensors["means"].detach()[parts].clone()
    offsets[:, 0] -= parameters.tensors["sh_dc"][parts, 0, 0].detach()
    assert len(offsets) == 2 * n / 10
    torch.testing.assert_close(offsets.std(0), torch.tensor([0.04, 0.08, 0.02]), rtol=0.1, atol=0)


def test_transparent_ones_are_pruned():
    parameters = make_parameters([0.005] * 3, [0.04, 0.06, 0.9])
    densify(parameters, make_record([0.0] * 3, [1.0] * 3), RULE, RADIUS, generator())
    assert colors(parameters) == [1, 2]


def test_oversized_ones_are_split_in_five_unless_hardly_seen():
    parameters = make_parameters([0.2, 0.2] + [0.02] * 18, [0.5] * 20)
    densify(parameters, make_record([0.0] * 20, [0.1, 9.0] + [1.0] * 18), RULE, RADIUS, generator())
    assert colors(parameters) == [1.0] * 5 + [float(i) for i in range(2, 20)]
    parts = parameters.tensors["log_scales"][parameters.tensors["sh_dc"][:, 0, 0] == 1].exp()
    torch.testing.assert_close(parts, torch.full((5, 2), 0.2 / (1.6 * 2.5**0.5)))


@pytest.mark.parametrize(("parts_weigh", "left"), [("share", 0), ("most", 10)])
def test_parts_of_the_least_weighted_go_or_stay_as_a_rule_says(parts_weigh, left):
    """A huge primitive that hardly anything shows is split in two, and its parts are oversized still."""
    parameters = make_parameters([0.4] + [0.02] * 19, [0.5] * 20)
    rule = dataclasses.replace(RULE, parts_weigh=parts_weigh, max_growth=0.0)
    densify(parameters, make_record([9.0] + [0.0] * 19, [2.0] + [3.0] * 19), rule, RADIUS, generator())
    assert colors(parameters) == [0.0] * left + [float(i) for i in range(1, 20)]


def test_the_cap_keeps_the_greatest_mean_weights():
    parameters = make_parameters([0.005] * 6, [0.5] * 6)
    record = DensificationRecord(6, torch.device("cpu"))
    record.add(torch.zeros(6), torch.tensor([5.0, 1.0, 4.0, 0.0, 2.0, 3.0]))
    record.add(torch.zeros(6), torch.tensor([5.0, 1.0, 4.0, 3.5, 2.0, 3.0]))  # the fourth is seen once: its mean is 3.5
    densify(parameters, record, DensificationRule(1.0, 0.05, max_primitives=3), RADIUS, generator())
    assert colors(parameters) == [0, 2, 3]


def growing(gradients, max_primitives: int) -> list[float]:
    """The colors that appear twice after a densification of 100 primitives whose weights rise with their color."""
    n = len(gradients)
    parameters = make_parameters([0.005] * n, [0.5] * n)
    record = make_record(gradients, [100.0 + i for i in range(n)])
    densify(parameters, record, DensificationRule(1.0, 0.05, max_primitives), RADIUS, generator())
    found = colors(parameters)
    return [color for color in range(n) if found.count(color) == 2]


def test_at_most_a_tenth_is_added_at_once_by_the_largest_gradients():
    gradients = [2.0 + 0.01 * i for i in range(100)]
    assert growing(gradients, max_primitives=1000) == list(range(90, 100))
    assert growing([0.5] * 50 + gradients[:50], max_primitives=1000) == list(range(90, 100))
    assert growing([0.5] * 97 + gradients[:3], max_primitives=1000) == [97, 98, 99]


def test_without_a_limit_all_grow_that_need_to_and_any_number_stays():
    gradients = [2.0 + 0.01 * i for i in range(100)]
    for most, expected in ((0, 200), (1000, 200), (150, 150)):
        rule = dataclasses.replace(RULE, max_growth=0.0, max_primitives=most)
        parameters = make_parameters([0.005] * 50 + [0.05] * 50, [0.5] * 100)
        densify(parameters, make_record(gradients, [1.0] * 100), rule, RADIUS, generator())
        assert len(parameters) == expected


@pytest.mark.parametrize(
    ("oversized", "expected"), [("prune", [2, 3]), ("keep", [0, 1, 2, 3]), ("split", [1] * 5 + [2, 3])]
)
def test_oversized_ones_are_pruned_split_or_kept(oversized, expected):
    parameters = make_parameters([0.2, 0.2, 0.02, 0.09], [0.5] * 4)
    record = make_record([0.0] * 4, [0.1, 9.0, 1.0, 1.0])
    densify(parameters, record, dataclasses.replace(RULE, max_growth=0.0), RADIUS, generator(), oversized)
    assert colors(parameters) == expected


def test_a_step_counts_in_the_mean_where_it_is_told_to():
    record = DensificationRecord(3, torch.device("cpu"))
    record.add(torch.tensor([3.0, 0.0, 2.0]), torch.tensor([1.0, 0.0, 1.0]), torch.tensor([True, True, True]))
    record.add(torch.tensor([1.0, 0.0, 0.0]), torch.tensor([1.0, 0.0, 0.0]), torch.tensor([True, True, False]))
    assert record.mean_gradient().tolist() == [2.0, 0.0, 2.0]
    assert record.mean_weight().tolist() == [1.0, 0.0, 1.0]


def test_what_fills_less_than_a_pixel_is_not_divided():
    rule = dataclasses.replace(RULE, min_coverage=1.0)
    record = make_record([2.0, 2.0] + [0.0] * 18, [0.9, 1.1] + [1.0] * 18)
    record.add(torch.tensor([2.0, 2.0] + [0.0] * 18), torch.tensor([1.0, 1.0] + [1.0] * 18))  # means 0.95 and 1.05
    parameters = make_parameters([0.005] * 20, [0.5] * 20)
    densify(parameters, record, rule, RADIUS, generator())
    assert colors(parameters) == [0, 1, 1, *range(2, 20)]


def test_what_few_views_show_is_not_divided():
    """Ten steps: two primitives are shown by three of them, the second almost only by one, the third by all alike."""
    rule = dataclasses.replace(RULE, min_views=2.9)
    record = DensificationRecord(30, torch.device("cpu"))
    for step in range(10):
        weights = [float(step < 3), [20.0, 1.0, 1.0][step] if step < 3 else 0.0, 5.0] + [1.0] * 27
        record.add(torch.tensor([2.0, 2.0, 2.0] + [0.0] * 27), torch.tensor(weights))
    torch.testing.assert_close(record.effective_views()[:3], torch.tensor([3.0, 22.0**2 / 402, 10.0]))
    parameters = make_parameters([0.005] * 30, [0.5] * 30)
    densify(parameters, record, rule, RADIUS, generator())
    assert colors(parameters) == [0, 0, 1, 2, 2, *range(3, 30)]


def test_the_cap_limits_how_many_are_added():
    gradients = [2.0 + 0.01 * i for i in range(100)]
    assert growing(gradients, max_primitives=107) == list(range(93, 100))


def test_at_the_cap_a_twentieth_takes_the_place_of_the_least_weighted():
    """The parts of the grown count half their weight, still more than that of the first five."""
    parameters = make_parameters([0.005] * 100, [0.5] * 100)
    gradients, weights = [0.0] * 100, [1.0 + i for i in range(100)]
    gradients[95:] = [2.0] * 5
    densify(parameters, make_record(gradients, weights), DensificationRule(1.0, 0.05, 100), RADIUS, generator())
    assert colors(parameters) == sorted([*range(5, 100), *range(95, 100)])


def test_moments_follow_through_a_densification():
    parameters = make_parameters([0.005, 0.05, 0.005] + [0.005] * 20, [0.5, 0.5, 0.01] + [0.5] * 20)
    for value in parameters.tensors.values():
        value.grad = torch.ones_like(value)
    parameters.optimizer.step()
    densify(parameters, make_record([2.0, 2.0, 0.0] + [0.0] * 20, [1.0] * 23), RULE, RADIUS, generator())
    moment = parameters.optimizer.state[parameters.tensors["means"]]["exp_avg"]
    assert moment.shape == (24, 3)
    assert (moment != 0).all(dim=1).sum() == 21  # rows that stay keep theirs; the clone and the parts start anew


def test_the_criterion_is_a_mean_over_the_views_that_saw_a_primitive():
    record = DensificationRecord(2, torch.device("cpu"))
    record.add(torch.tensor([3.0, 0.0]), torch.tensor([1.0, 0.0]))
    record.add(torch.tensor([1.0, 8.0]), torch.tensor([1.0, 1.0]))
    assert record.mean_gradient().tolist() == [2.0, 8.0]


@pytest.mark.parametrize("n", [0, 1, 2])
def test_tiny_sets(n):
    parameters = make_parameters([0.2] * n, [0.5] * n)
    densify(parameters, make_record([2.0] * n, [1.0] * n), RULE, RADIUS, generator())
    assert torch.isfinite(parameters.tensors["means"]).all()


def test_screen_criterion_is_the_gradient_of_the_projected_center():
    width, height = 64, 48
    pose = torch.eye(4)
    pose[:3, :3] = torch.linalg.qr(torch.randn(3, 3, generator=generator()))[0]
    pose[:3, :3] *= torch.linalg.det(pose[:3, :3])
    pose[:3, 3] = torch.tensor([0.1, -0.2, 3.0])
    intrinsics = torch.tensor([[70.0, 0, 30], [0, 55.0, 26], [0, 0, 1]])
    camera = Camera(pose, intrinsics, width, height)
    means = (torch.rand(5, 3, generator=generator()) - 0.5).requires_grad_()
    pixels, depth = camera.project(means)
    per_pixel = torch.randn(5, 2, generator=generator())
    (gradient,) = torch.autograd.grad((pixels * per_pixel).sum(), means)
    statistics = Statistics(torch.ones(5), (depth[:, None] * gradient).detach())
    expected = (per_pixel * torch.tensor([width / 2, height / 2])).norm(dim=1)
    torch.testing.assert_close(screen_criterion(statistics, camera, means), expected, rtol=1e-4, atol=1e-5)


def test_spatial_criterion_is_half_the_depth_times_the_gradient():
    statistics = Statistics(torch.ones(1), 4.0 * torch.tensor([[0.0, 3.0, -4.0]]))
    camera = Camera(torch.eye(4), torch.eye(3), width=4, height=4)
    assert spatial_criterion(statistics, camera, torch.zeros(1, 3)).tolist() == [10.0]


def test_camera_criterion_is_half_the_way_to_the_camera_times_the_gradient():
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor([1.0, 2.0, 3.0])
    means = torch.tensor([[1.0, 2.0, 15.0], [4.0, 6.0, 3.0]], requires_grad=True)
    means.grad = torch.tensor([[0.0, 3.0, -4.0], [2.0, 0.0, 0.0]])
    camera = Camera(pose, torch.eye(3), width=4, height=4)
    statistics = Statistics(torch.ones(2), torch.full((2, 3), torch.nan))
    assert camera_criterion(statistics, camera, means).tolist() == [30.0, 5.0]
