"""The training loop and the evaluation, on methods whose every number is known."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fakes.methods import LosesItsLoss, MeanColor, Settings
from PIL import Image

from envgs_bench.metrics import get_protocol
from envgs_bench.stages.evaluation import evaluate, normal_error
from envgs_bench.stages.health import Diverged
from envgs_bench.stages.pictures import depth_picture, depth_unit, error_picture, save_png
from envgs_bench.stages.training import Training, shuffled
from envgs_bench.testing import tiny_scene


def nothing(event: dict[str, Any]) -> None:
    pass


def trained(steps: int, folder: Path, seed: int = 0) -> tuple[MeanColor, Training]:
    method = MeanColor(Settings())
    training = Training(method, tiny_scene(), steps, seed)
    training.run(folder / "curve.csv", nothing)
    return method, training


def test_every_view_is_seen_once_before_any_is_seen_again() -> None:
    views = tiny_scene().train
    names = [view.name for view in shuffled(views, 4 * len(views), seed=3)]
    rounds = [names[start : start + len(views)] for start in range(0, len(names), len(views))]
    assert all(sorted(one) == sorted(view.name for view in views) for one in rounds)
    assert len({tuple(one) for one in rounds}) > 1


def test_the_order_depends_on_the_seed_alone() -> None:
    views = tiny_scene().train

    def order(seed: int) -> list[str]:
        return [view.name for view in shuffled(views, 12, seed)]

    state = torch.random.get_rng_state()
    assert order(1) == order(1) != order(2)
    assert torch.equal(torch.random.get_rng_state(), state)


def test_a_seed_trains_to_the_same_model(tmp_path: Path) -> None:
    assert torch.equal(trained(9, tmp_path)[0].color, trained(9, tmp_path)[0].color)
    assert not torch.equal(trained(9, tmp_path)[0].color, trained(9, tmp_path, seed=1)[0].color)


def test_the_curve_thins_out_and_ends_with_the_last_step(tmp_path: Path) -> None:
    trained(1003, tmp_path)
    with (tmp_path / "curve.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row["step"]) for row in rows] == [*range(2, 1003, 2), 1003]
    seconds = [float(row["seconds"]) for row in rows]
    assert seconds == sorted(seconds)
    assert {row["primitives_base"] for row in rows} == {"1"}
    assert {row["skipped_steps"] for row in rows} == {"0"}


def test_the_running_psnr_is_the_mean_of_the_last_round(tmp_path: Path) -> None:
    class Counts(MeanColor):
        def training_step(self, view: Any, step: int) -> dict[str, float]:
            return {"loss": 1.0, "psnr": float(step)}

    scene = tiny_scene()
    Training(Counts(Settings()), scene, 20, 0).run(tmp_path / "curve.csv", nothing)
    with (tmp_path / "curve.csv").open() as stream:
        last = list(csv.DictReader(stream))[-1]
    assert float(last["psnr"]) == np.mean(range(21 - len(scene.train), 21))


def test_progress_ends_at_the_last_step(tmp_path: Path) -> None:
    events: list[dict[str, Any]] = []
    Training(MeanColor(Settings()), tiny_scene(), 30, 0).run(tmp_path / "curve.csv", events.append)
    assert events[-1]["step"] == events[-1]["steps"] == 30
    assert events[-1]["primitives"] == {"base": 1, "env": 0}
    assert {"stage", "loss", "psnr"} <= set(events[-1])


def test_the_peak_is_the_most_of_all_sets_together(tmp_path: Path) -> None:
    class Breathes(MeanColor):
        step = 0

        def training_step(self, view: Any, step: int) -> dict[str, float]:
            self.step = step
            return {"loss": 1.0}

        def primitives(self) -> dict[str, int]:
            return {"base": 10 + self.step, "env": 100 - 3 * self.step}

    training = Training(Breathes(Settings()), tiny_scene(), 20, 0)
    training.run(tmp_path / "curve.csv", nothing)
    assert training.peak_primitives == 11 + 97


@pytest.mark.parametrize(("steps", "last"), [(100, 22), (3, None)])
def test_a_loss_that_stays_not_finite_is_a_divergence(tmp_path: Path, steps: int, last: int | None) -> None:
    training = Training(LosesItsLoss(Settings(crash_at=3)), tiny_scene(), steps, 0)
    if last is None:  # one step of three
        training.run(tmp_path / "curve.csv", nothing)
    else:
        with pytest.raises(Diverged, match=f"up to step {last}"):
            training.run(tmp_path / "curve.csv", nothing)


def test_losses_of_a_device_are_read_ten_steps_at_once_and_judged_one_by_one(tmp_path: Path) -> None:
    """19 steps without a loss, one with, and 20 without: the run diverges in step 42, noticed after step 50."""

    class OnDevice(MeanColor):
        def training_step(self, view: Any, step: int) -> dict[str, torch.Tensor]:
            lost = step >= 3 and step != 22
            return {"loss": torch.tensor(math.nan if lost else 1.0), "psnr": torch.tensor(float(step))}

    training = Training(OnDevice(Settings()), tiny_scene(), 20_000, 0)
    with pytest.raises(Diverged, match="in 20 steps in a row, up to step 42"):
        training.run(tmp_path / "curve.csv", nothing)
    assert training.step == 50


def test_evaluation_scores_what_was_drawn(tmp_path: Path) -> None:
    method, _ = trained(50, tmp_path)
    views = tiny_scene().test
    left = torch.zeros(views[0].image.shape[:2], dtype=torch.bool)
    left[:, :8] = True
    views[0].masks.update(left=left, nowhere=torch.zeros_like(left))
    metrics, masked = evaluate(method, views, get_protocol("strict"), tmp_path, nothing)

    drawn = (method.color * 255).round() / 255
    squared = (drawn - views[0].rgb()).square()
    expected = -10 * math.log10(float(squared.double().mean()))
    assert metrics.mean["psnr"] == pytest.approx(expected, abs=1e-4)
    assert metrics.per_view[0].scores["psnr"] == pytest.approx(expected, abs=1e-4)
    assert set(masked) == {"left"}
    assert masked["left"].fraction == 0.25
    of_region = -10 * math.log10(float(squared[:, :8].double().mean()))
    assert masked["left"].scores["psnr"] == pytest.approx(of_region, abs=1e-4)

    render = np.asarray(Image.open(tmp_path / "renders" / f"{views[0].name}.png"))
    assert (render == (method.color * 255).round().byte().numpy()).all()
    target = np.asarray(Image.open(tmp_path / "targets" / f"{views[0].name}.png"))
    assert (target == views[0].image.numpy()).all()
    layer = np.asarray(Image.open(tmp_path / "layers/beta" / f"{views[0].name}.png"))
    assert layer.shape == target.shape[:2]
    assert (layer == 128).all()


def test_means_over_views_are_unweighted(tmp_path: Path) -> None:
    method, _ = trained(50, tmp_path)
    metrics, _ = evaluate(method, tiny_scene().train, get_protocol(), tmp_path, nothing)
    each = [view.scores["ssim"] for view in metrics.per_view]
    assert metrics.mean["ssim"] == pytest.approx(np.mean(each))


def test_a_render_that_is_not_finite_is_a_divergence(tmp_path: Path) -> None:
    method, _ = trained(1, tmp_path)
    method.color = torch.tensor([0.0, math.inf, 0.0])
    with pytest.raises(Diverged, match=r"view0 is not finite in 33\.3%"):
        evaluate(method, tiny_scene().test, get_protocol(), tmp_path, nothing)


def test_the_normal_error_is_the_angle() -> None:
    reference = torch.zeros(1, 4, 3)
    reference[0, :3, 2] = 1  # the fourth is unknown
    angle = math.radians(30)
    normal = torch.tensor(
        [[[0.0, 0.0, 0.2], [math.sin(angle), 0.0, math.cos(angle)], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]]
    )
    assert normal_error(normal, reference) == pytest.approx((0 + 30 + 90) / 3)
    assert normal_error(normal, reference, torch.tensor([[False, True, False, True]])) == pytest.approx(30)
    assert normal_error(normal, reference, torch.tensor([[False, False, False, True]])) is None


def test_a_png_is_clamped_and_rounded(tmp_path: Path) -> None:
    values = torch.tensor([[-1.0, 0.0, 0.5 / 255 + 1e-4, 0.4 / 255, 1.0, 2.0]])
    save_png(tmp_path / "a" / "b.png", values)
    assert np.asarray(Image.open(tmp_path / "a" / "b.png")).tolist() == [[0, 0, 1, 0, 255, 255]]


def test_depth_is_gray_at_the_cameras_distance_and_black_where_nothing_is() -> None:
    views = tiny_scene().train
    centers = torch.stack([view.camera.center for view in views])
    unit = depth_unit([view.camera for view in views])
    assert unit == pytest.approx(float((centers - centers.mean(0)).norm(dim=-1).mean()))
    assert depth_unit([views[0].camera] * 3) == 1
    gray = depth_picture(torch.tensor([[0.0, 1e-6 * unit, unit, 1e9 * unit]]), unit)
    np.testing.assert_allclose(gray, [[0, 1, 0.5, 0]], atol=1e-5)


def test_errors_are_shown_four_times_as_large() -> None:
    target = torch.full((2, 2, 3), 0.5)
    image = target + torch.tensor([0.1, -0.2, 0.0])
    np.testing.assert_allclose(error_picture(image, target), 0.4, atol=1e-6)
