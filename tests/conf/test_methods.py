"""Methods as configurations: made from their settings dataclasses, variants from their differences."""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any, Literal

import pytest
import yaml
from fakes.runs import CONF, only_folder, set_environment, without_processes
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from schedules import begin, due
from tuned_baselines import TUNED

from envgs_bench.cli import composition
from envgs_bench.cli.composition import config_names, register_choices
from envgs_bench.cli.main import main
from envgs_bench.cli.setting_comments import setting_comments
from envgs_bench.methods import registry
from envgs_bench.methods.envgs import EnvGS
from envgs_bench.methods.lighting.settings import ReflectionSettings
from envgs_bench.methods.recipes import RECIPES, Rules, rules_of
from envgs_bench.methods.registry import BUILT_IN, create_method, method_class
from envgs_bench.methods.settings import LEARNING_RATES, make_settings, quickness
from envgs_bench.records import ELSEWHERE
from envgs_bench.settings import read_settings
from envgs_bench.testing import tiny_scene

LEAN = {"prune_error": 0.05}
MIRRORED = TUNED | {
    **{"rotation_lr_final": 3e-4, "normal_weight": 0.04, "normal_from": 7_000},
    **{"mono_weight": 0.05, "map_levels": 7},
}
COLORS = {"sh_lr": 2.5e-3, "albedo_lr": 1e-3}
DIFFERENCES = {
    **{kind: {} for kind in BUILT_IN},
    "2dgs_tuned": TUNED,
    "3dgs_tuned": TUNED,
    "3igs_tuned": TUNED | {"sh_degree": 0},
    "gaussian_shader_tuned": TUNED | {"rotation_lr_final": 3e-4, "mono_weight": 0.05},
    "ref_dgs": {"recipe": "ref_dgs", "near_set": True, "densify_until": 10_000},
    "ref_gs_tuned": MIRRORED | COLORS,
    "ref_dgs_tuned": MIRRORED | COLORS | {"near_set": True, "rules": {"plain_share": "rest"}},
    "rt_splatting_tuned": MIRRORED | {"sh_lr": 2.5e-3, "perceptual_weight": 0.0, "warm_up": 0},
    "envgs_no_joint": {"joint": False},
    "envgs_planes": {"planes": "photographs"},
    "envgs_far_map": {"rules": {"traced_background": "map"}},
    "2dgs_lean": TUNED | LEAN,
    "3dgs_lean": TUNED | LEAN,
    **{f"{kind}_mcmc": TUNED | {"rules": {"growth": "mcmc"}} for kind in ("2dgs", "3dgs")},
    "envgs_lean": {"prune_error": 0.05, "reflection_pilot": True},
}
ABLATIONS = {  # of the published recipe
    "envgs_paper_no_joint": {"joint": False},
    "envgs_paper_no_mono_normal": {"mono_weight": 0.0},
    "envgs_paper_no_color_sabotage": {"sabotage": False},
    "envgs_paper_no_normal_propagation": {"propagate": False},
    "envgs_paper_no_perceptual": {"perceptual_weight": 0.0},
}
SYNTHETIC = {
    "sh_from": 10_000,
    "env_sh_from": 10_000,
    "warm_up": 6_000,
    "initial_beta": 0.1,
    "beta_reset_from": 9_000,
    "env_densify_until": 42_000,
    "oversized": "prune",
    "env_opacity_reset_every": 3_000,
    "normal_from": 4_000,
    "mono_from": 4_000,
    "normal_weighting": "alpha",
    "perceptual_weight": 0.0,
    "reflect_alpha": 0.75,
    "reflect_alpha_from": 30_000,
}
LATE = {"perceptual_from": 45_000}
RELEASED = {  # what EnvGS's released code sets apart, by scene
    "toy/chrome_room": {},
    "mipnerf360/garden": {},
    "ref_real/sedan": {"densify_until": 30_000, "env_densify_until": 30_000, "disturb_until": 24_000},
    "ref_real/toycar": {"sh_from": 10_000},
    "ref_real/spheres": {"sh_from": 10_000, "initial_beta": 0.1, "perceptual_weight": 0.1},
    **dict.fromkeys(("envgs/audi", "envgs/dog", "nerf_casting/compact", "nerf_casting/hatchback"), LATE),
    **dict.fromkeys(("nerf_casting/grinder", "nerf_casting/toaster"), LATE | {"initial_beta": 0.01}),
    **{f"shiny_blender/{name}": SYNTHETIC for name in ("car", "coffee", "helmet", "teapot", "toaster")},
    "shiny_blender/ball": SYNTHETIC | {"initial_beta": 0.8},
}
TUNED_RIVALS = {  # where they are not as the environment map
    "3dgs_dr_tuned": {"min_opacity", "normal_weight", "normal_from", "beta_threshold"},
    "ref_gaussian_tuned": {"beta_threshold"},
}
RELEASED_RIVALS = [  # method, scene, steps that are trained at most, and settings that say nothing of how long
    ("3dgs_dr", "ref_real/sedan", 97_000, {"scope_radius": 0.5}),
    ("ref_gaussian", "ref_real/sedan", 20_000, {"shade_until": 0, "smooth_weight": 0.0}),
    ("ref_gaussian", "ref_real/spheres", 20_000, {"shade_until": 0, "smooth_weight": 0.45}),
    ("ref_gaussian", "shiny_blender/helmet", 50_000, {"smooth_weight": 1.0}),
    ("3igs", "ref_real/toycar", 30_000, {"field_size": 300}),
    ("ref_gs", "ref_real/toycar", 31_000, {"scope_radius": 0.5, "warm_up": 1_500, "normal_from": 1_500}),
    ("ref_gs", "ref_real/sedan", 31_000, {"scope_radius": 0.5, "warm_up": 700, "normal_from": 700}),
    ("rt_splatting", "ref_real/toycar", 31_000, {"scope_radius": 0.5, "warm_up": 1_500, "normal_from": 1_500}),
    ("rt_splatting", "ref_real/sedan", 31_000, {"scope_radius": 0.5}),
    ("ref_dgs", "ref_real/toycar", 15_000, {"scope_radius": 0.5, "warm_up": 1_500, "normal_from": 1_500}),
    ("ref_dgs", "ref_real/sedan", 15_000, {"scope_radius": 0.5, "warm_up": 700, "normal_from": 700}),
]
REPLACED = {"envmap_paper": "envmap", "envgs_paper_single_set": "envgs_single_set"}  # name -> kind


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


def composed(name: str) -> dict[str, Any]:
    """The node `method` of a run with method=<name>."""
    return copy.deepcopy(_composed(name))


@cache  # composing takes a while
def _composed(name: str) -> dict[str, Any]:
    register_choices()
    with initialize_config_dir(str(composition.CONF), version_base="1.3"):
        content = OmegaConf.to_container(compose("config", [f"method={name}"]).method)
    assert isinstance(content, dict)
    return {str(key): value for key, value in content.items()}


def in_force(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings and all rules, those of the recipe that are not overridden among them, side by side."""
    rules = dataclasses.asdict(rules_of(settings["recipe"], settings["rules"]))
    return {key: value for key, value in settings.items() if key != "rules"} | rules


@pytest.mark.parametrize("name", DIFFERENCES)
def test_a_configuration_holds_every_setting(name: str) -> None:
    method = composed(name)
    assert method["name"] == name
    assert method["kind"] in (name, name.rpartition("_")[0], "envgs", "envmap", "ref_gs")
    defaults = dataclasses.asdict(create_method(method["kind"]).settings)
    assert method["settings"] == defaults | DIFFERENCES[name]


@pytest.mark.parametrize("name", ABLATIONS)
def test_an_ablation_is_the_published_recipe_without_one_part(name: str) -> None:
    method, paper = composed(name), composed("envgs_paper")
    assert method["name"] == name
    assert method["kind"] == paper["kind"] == "envgs"
    assert method["settings"] == paper["settings"] | ABLATIONS[name]
    ((part, without),) = ABLATIONS[name].items()
    assert paper["settings"][part] != without
    assert paper["settings"]["disturb_every"] > 0  # or neither sabotage nor propagation would ever happen


@pytest.mark.parametrize("name", REPLACED)
def test_what_replaces_the_environment_leaves_the_rest_of_the_published_recipe(name: str) -> None:
    method, paper = composed(name), composed("envgs_paper")
    assert (method["name"], method["kind"]) == (name, REPLACED[name])
    create_method(method["kind"], method["settings"])
    common = method_class("envgs_single_set").Settings if method["kind"] != "envmap" else ReflectionSettings
    shared = {field.name for field in dataclasses.fields(common)}
    assert {key: method["settings"][key] for key in shared} == {key: paper["settings"][key] for key in shared}


@pytest.mark.parametrize("name", TUNED_RIVALS)
def test_a_tuned_rival_is_given_what_the_environment_map_is(name: str) -> None:
    rival, envmap = composed(name), composed("envmap")
    assert (rival["name"], rival["kind"]) == (name, name.removesuffix("_tuned"))
    create_method(rival["kind"], rival["settings"])
    ours, theirs = in_force(envmap["settings"]), in_force(rival["settings"])
    unlike = {key for key, value in ours.items() if theirs[key] != value}
    assert unlike - {"disturb_until"} == TUNED_RIVALS[name]  # what is never disturbed ends that at no step


@pytest.mark.parametrize(("name", "scene", "steps", "settings"), RELEASED_RIVALS)
def test_a_rival_trains_a_scene_as_its_release_does(
    name: str, scene: str, steps: int, settings: dict[str, Any]
) -> None:
    found = run_on(scene, name)
    assert create_method(composed(name)["kind"], found).training_steps(100_000) == steps
    assert settings.items() <= found.items()
    assert in_force(run_on("toy/chrome_room", name)) == in_force(composed(name)["settings"])
    tuned = f"{name}_tuned"
    assert in_force(run_on(scene, tuned)) == in_force(composed(tuned)["settings"])  # our own is no release's


def test_ref_gaussian_on_captures_does_everything_at_the_released_steps() -> None:
    method = create_method("ref_gaussian", run_on("ref_real/sedan", "ref_gaussian") | {"envmap_size": 4})
    method.initialize(tiny_scene(), 20_000)
    stages = []
    for step in (3_000, 3_001, 10_000, 10_001):
        begin(method, step)
        stages.append((method.reflection.begun, method.surfaces.deferred, method.surfaces.occluders.traced))
    assert stages == [(False, False, False), (True, True, False), (True, True, False), (True, True, True)]
    events = {step: due(method, step) for step in (600, 3_000, 4_000, 17_000, 19_500)}
    assert "densify_base" in events[600]
    assert "densify_base" in events[19_500]
    assert {"reset_base_opacity", "reset_beta"} <= events[3_000]
    assert "propagate" in events[4_000]
    assert "propagate" in events[17_000]


def test_ref_gaussian_on_captures_has_the_released_rates() -> None:
    """Those of the positions fall for 30,000 steps there, of which 20,000 are trained; opacities are held for 200."""
    method = create_method("ref_gaussian", run_on("ref_real/sedan", "ref_gaussian") | {"envmap_size": 4})
    method.initialize(tiny_scene(), 20_000)
    base, radius = method.model.policies["base"], method.model.radius
    for step in (1, 10_000, 20_000):
        assert base.position_rate(step, radius) == pytest.approx(1.6e-4 * 0.01 ** (step / 30_000) * radius, rel=2e-3)
    rates = base.rates
    assert (base.rotation_rate(1), rates.sh_dc, rates.sh_rest, rates.beta) == pytest.approx(
        (1e-3, 7.5e-3, 3.75e-4, 5e-3)
    )
    method.parts["disturbance"].propagate(4_000)
    assert method.model.sets["base"].held_until == 4_200


def test_ref_dgs_on_captures_has_the_released_rates() -> None:
    """Those of the positions fall for 25,000 steps there, of which 15,000 are trained; no rate is a short run's."""
    method = create_method("ref_gs", run_on("ref_real/toycar", "ref_dgs") | {"map_levels": 3})
    method.initialize(tiny_scene(), 15_000)
    radius = method.model.radius
    for policy in method.model.policies.values():
        for step in (1, 10_000, 15_000):
            expected = 1.6e-4 * 0.01 ** (step / 25_000) * radius
            assert policy.position_rate(step, radius) == pytest.approx(expected, rel=2e-3)
    rates = method.model.policies["base"].rates
    materials = {"albedo_logs": 5e-4, "roughness_logits": 2e-3, "feature_logits": 2e-3}
    assert (rates.sh_dc, rates.materials) == (2e-3, materials)


def test_the_published_configurations_are_what_was_published() -> None:
    """Spot checks against the paper's Sec. 4.3 and App. C, and the release's schedule."""
    paper, released = (composed(f"envgs_{name}") for name in ("paper", "released"))
    assert paper["kind"] == released["kind"] == "envgs"
    for expected, method in (
        (
            {
                "sh_degree": 2,
                "stretches": False,
                "env_grid": 32,
                "mono_loss": "cos",
                "perceptual_from": 0,
                "beta_threshold": 0,
                "traced_sh_direction": "ray",
                "initial_orientation": "positive",
                "mean_gradient_over": "in_view",
                "mean_gradient_of": "own",
                "max_growth": 0,
                "oversized": "split",
            },
            paper,
        ),
        (
            {
                "sh_degree": 3,
                "stretches": False,
                "env_grid": 32,
                "env_radius_power": 2,
                "env_gradient": "camera",
                "env_position_scale": 1,
                "traced_sh_direction": "ray",
                "traced_background": "black",
                "traced_near": 0.06,
                "ray_offset": 0,
                "normal_reference": "alpha",
                "mono_loss": "l1_cos",
                "mono_rendered": "unit",
                "normal_weighting": "depth",
                "perceptual_loss": "lpips",
                "perceptual_from": 21_000,
            },
            released,
        ),
    ):
        assert expected.items() <= in_force(method["settings"]).items()
        create_method("envgs", method["settings"])


def test_the_tuned_baselines_have_the_growth_and_the_colors_of_the_other_methods() -> None:
    shared = dataclasses.asdict(ReflectionSettings()) | {"rotation_lr_final": 1e-3}
    for kind in ("2dgs", "3dgs"):
        published, tuned = (composed(name)["settings"] for name in (kind, f"{kind}_tuned"))
        assert {key for key in published if published[key] != tuned[key]} == set(TUNED)
        assert {key: tuned[key] for key in TUNED} == {key: shared[key] for key in TUNED}


@pytest.mark.parametrize("scene", RELEASED)
def test_the_release_trains_a_scene_as_the_scenes_preset_says(scene: str) -> None:
    settings = run_on(scene, "envgs_released")
    assert in_force(settings) == in_force(composed("envgs_released")["settings"]) | RELEASED[scene]
    create_method("envgs", settings)
    assert in_force(run_on(scene, "envgs_paper")) == in_force(composed("envgs_paper")["settings"])


def test_a_setting_that_is_given_counts_before_the_scenes_release() -> None:
    overrides = ("method.settings.initial_beta=0.25", "method.settings.rules.mono_from=7")
    given = in_force(run_on("shiny_blender/ball", "envgs_released", *overrides))
    expected = {"initial_beta": 0.25, "mono_from": 7}
    assert given == in_force(run_on("shiny_blender/ball", "envgs_released")) | expected


def run_on(scene: str, method: str, *overrides: str) -> dict[str, Any]:
    """The settings of a method on a scene."""
    return copy.deepcopy(_run_on(scene, method, *overrides))


@cache
def _run_on(scene: str, method: str, *overrides: str) -> dict[str, Any]:
    run = composition.composed([f"dataset={scene}", f"method={method}", *overrides])
    assert "release" not in run.dataset
    return run.method.settings


def events(scene: str, steps: int) -> dict[str, list[int]]:
    """For each event the steps of a run of EnvGS as released in which it happens."""
    method = create_method("envgs", run_on(scene, "envgs_released"))
    assert isinstance(method, EnvGS)
    method.initialize(tiny_scene(), steps)
    found: dict[str, list[int]] = {}
    for step in range(1, steps + 1):
        for event in due(method, step):
            found.setdefault(event, []).append(step)
    return found


def thousands(*numbers: int) -> list[int]:
    return [1000 * number for number in numbers]


def test_the_sedan_grows_and_is_disturbed_for_longer() -> None:
    """In 60,000 steps; the released code's loop has so many of each."""
    found = events("ref_real/sedan", 60_000)
    counts = {name: len(steps) for name, steps in found.items()}
    assert [counts[name] for name in ("densify_base", "densify_env", "propagate", "sabotage")] == [126, 53, 14, 14]
    assert [counts[name] for name in ("reset_base_opacity", "reset_beta", "reset_env_opacity")] == [9, 8, 4]
    assert found["densify_base"] == [
        *range(600, 3001, 100),
        *range(3500, 24_001, 500),
        *range(24_100, 30_000, 100),
    ]
    assert found["propagate"] == thousands(4, 5, 7, 8, 10, 11, 13, 14, 16, 17, 19, 20, 22, 23)


def test_the_synthetic_scenes_have_a_schedule_of_their_own() -> None:
    found = events("shiny_blender/car", 60_000)
    assert found.pop("densify_base") == [*range(600, 6001, 100), *range(6500, 18_001, 500), *range(18_100, 21_000, 100)]
    assert found.pop("densify_env") == list(range(6500, 42_000, 500))
    assert found.pop("sabotage") == found.pop("propagate") == thousands(7, 8, 10, 11, 13, 14, 16, 17)
    assert found.pop("reset_base_opacity") == list(range(3000, 21_000, 3000))
    assert found.pop("reset_beta") == list(range(9000, 21_000, 3000))
    assert found.pop("reset_env_opacity") == list(range(9000, 42_000, 3000))
    assert not found


@pytest.mark.parametrize("name", [name for name in config_names("method") if name not in ELSEWHERE])
def test_a_configuration_is_slow_only_once_its_rates_are_lowered(name: str) -> None:
    method = composed(name)
    settings = make_settings(method_class(method["kind"]).Settings, method["settings"], name)
    rates = {key: value for key, value in dataclasses.asdict(settings).items() if key.endswith(LEARNING_RATES)}
    assert quickness(settings) == 1
    assert quickness(dataclasses.replace(settings, **{key: 3 * rate for key, rate in rates.items()})) == 1
    slow = dataclasses.replace(settings, **{key: rate / 3 for key, rate in rates.items()})
    assert quickness(slow) == pytest.approx(1 / 3)


def test_what_has_no_learning_rates_is_not_slow() -> None:
    @dataclass(frozen=True)
    class Settings:
        samples: int = 3

    assert quickness(Settings(1)) == 1


def test_every_configuration_is_tested() -> None:
    tested = {*DIFFERENCES, *ABLATIONS, *REPLACED, *TUNED_RIVALS, "envgs_paper", "envgs_released", *ELSEWHERE}
    assert tested == set(config_names("method"))


@pytest.mark.parametrize("settings_type", [Rules, *(method_class(kind).Settings for kind in BUILT_IN)])
def test_every_setting_says_what_it_is(settings_type: type) -> None:
    comments = setting_comments(settings_type)
    assert {field.name for field in dataclasses.fields(settings_type)} <= set(comments)
    assert all(len(comment) > 10 for comment in comments.values()), comments


def test_comments_are_inherited_unless_a_subclass_says_more() -> None:
    @dataclass(frozen=True)
    class Base:
        silent: int = 1
        plain: str = "# no comment"  # of the base
        changed: tuple[int, ...] = (
            1,
            2,
        )  # behind the last line

    @dataclass(frozen=True)
    class Derived(Base):
        """With a string: int = 1  # that is none of it"""

        plain: str = "other"
        changed: tuple[int, ...] = ()  # said anew

    assert setting_comments(Base) == {"plain": "of the base", "changed": "behind the last line"}
    assert setting_comments(Derived) == {"plain": "of the base", "changed": "said anew"}


def test_a_methods_settings_are_listed_with_defaults_and_comments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "method", "envgs"]) == 0
    lines = [line.split(None, 2) for line in capsys.readouterr().out.splitlines()]
    rows = {line[0]: (line[1], line[2].strip()) for line in lines if len(line) == 3}
    assert rows["sh_degree"] == ("2", "degree of the view-dependent color's spherical harmonics, 0 to 3")
    assert rows["joint"] == ("true", "reflected rays pass gradients on to the base set's normals and positions")
    assert rows["densify_until"] == ("25000", "step before which densification and opacity resets end")
    assert {field.name for field in dataclasses.fields(method_class("envgs").Settings)} <= set(rows)


def test_a_variant_is_listed_by_its_differences(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "method", "envgs_no_joint"]) == 0
    shown = capsys.readouterr().out
    assert [line.split()[:3] for line in shown.splitlines() if line.startswith("joint")] == [["joint", "false", "true"]]
    assert "beta_lr" not in shown
    assert "envgs-bench list method envgs" in shown


def test_a_method_that_is_not_there_cannot_be_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "method", "envgz"]) == 2
    assert "Did you mean 'envgs'?" in capsys.readouterr().err


def test_what_configurations_share_is_no_method(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "method=envgz", "--cfg", "job"]) == 2
    assert "_published" not in capsys.readouterr().err


def test_an_installed_packages_method_is_offered_with_its_defaults(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    points = EntryPoints(
        [
            EntryPoint("mean", "fakes.methods:MeanColor", registry.ENTRY_POINT_GROUP),
            EntryPoint("broken", "fakes.nowhere:Method", registry.ENTRY_POINT_GROUP),
        ]
    )
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    assert main(["run", "method=mean", "method.settings.rate=0.75", "--cfg", "job"]) == 0
    shown = capsys.readouterr()
    assert "rate: 0.75" in shown.out
    assert "crash_at: 0" in shown.out
    assert "method 'broken' cannot be imported from fakes.nowhere:Method" in shown.err
    assert main(["list", "method", "mean"]) == 0
    assert "share of the way to each view's mean color" in capsys.readouterr().out


def test_a_method_is_chosen_by_its_import_path(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "method=fakes.methods:MeanColor", "method.settings.rate=1", "--cfg", "job"]) == 0
    shown = capsys.readouterr().out
    for line in ("name: MeanColor", "kind: fakes.methods:MeanColor", "rate: 1", "crash_at: 0"):
        assert line in shown
    assert main(["run", "method=fakes.nowhere:Method", "--cfg", "job"]) == 2
    assert "method 'fakes.nowhere:Method' cannot be imported: " in capsys.readouterr().err


def test_a_stored_configuration_holds_every_setting(tmp_path: Path) -> None:
    """A YAML file of somebody's own may leave settings out; the one in the run's folder does not."""
    (tmp_path / "method").mkdir()
    (tmp_path / "method" / "mine.yaml").write_text(
        yaml.safe_dump({"name": "mine", "kind": "fakes.methods:MeanColor", "settings": {"rate": 0.25}})
    )
    (tmp_path / "dataset").symlink_to(CONF / "dataset")
    arguments = ["method=mine", "dataset=tiny", "steps=2", "timing.frames=1", "timing.seconds=0.01", "device=cpu"]
    with without_processes():
        assert main(["run", "--config-dir", str(tmp_path), *arguments, f"runs_dir={tmp_path / 'runs'}"]) == 0
    assert read_settings(only_folder(tmp_path / "runs")).method.settings == {
        "rate": 0.25,
        "crash_at": 0,
        "tells_psnr": True,
    }


def test_settings_of_any_type_are_offered_and_checked() -> None:
    @dataclass(frozen=True)
    class Settings:
        mode: Literal["a", "b"] = "a"
        sizes: tuple[int, ...] = (1, 2)
        share: float = 0.5

    assert make_settings(Settings, {"sizes": [3], "share": 1}, "it: ") == Settings(sizes=(3,), share=1.0)
    for values in ({"mode": "c"}, {"sizes": [0.5]}, {"share": "much"}, {"share": True}, {"shares": 1.0}):
        with pytest.raises(ValueError, match=f"it: {next(iter(values))}"):
            make_settings(Settings, values, "it: ")


def test_recipes_are_listed_rule_by_rule(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "recipes"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == ["rule", *RECIPES]
    rows = {line[0]: line[1 : 1 + len(RECIPES)] for line in lines[1:] if line}
    assert rows["oversized"] == ["split", "prune", "prune", "split", "split", *["prune"] * 6]
    assert {field.name for field in dataclasses.fields(Rules)} <= set(rows)


def test_a_kind_of_data_set_is_listed_with_defaults_and_comments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "dataset", "photos"]) == 0
    shown = capsys.readouterr().out
    assert ["root", "has", "to", "be", "given"] in [line.split()[:5] for line in shown.splitlines()]
    assert "feature_size" in shown
    assert main(["list", "dataset", "polaroids"]) == 2
