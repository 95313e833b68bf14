"""Every method end to end on a tiny scene: it learns, repeats, is saved, and survives a NaN."""

import dataclasses

import pytest
import torch
from rules import with_rules
from schedules import begin, due, optimizers_of
from small_methods import SMALL

from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.gaussians import policy
from envgs_bench.methods.method import Method
from envgs_bench.methods.registry import create_method, method_names
from envgs_bench.methods.settings import TwoDGSSettings, make_settings

KINDS = ("2dgs", "3dgs", "envmap", "envgs", "envgs_single_set", "3dgs_dr", "ref_gaussian", "gaussian_shader", "3igs")
STEPS = 60


def look_at(eye: torch.Tensor) -> torch.Tensor:
    """World-to-camera pose at `eye`, looking at the origin."""
    forward = torch.nn.functional.normalize(-eye, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(torch.tensor([0.0, 1, 0]), forward), dim=0)
    pose = torch.eye(4)
    pose[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A picture on the plane z = 0, seen by six cameras."""
    width, height = 24, 18
    generator = torch.Generator().manual_seed(3)
    views = []
    for k in range(6):
        intrinsics = torch.tensor([[24.0, 0, 12], [0, 24, 9], [0, 0, 1]])
        camera = Camera(look_at(torch.tensor([0.5 * (k - 2.5), 0.3, -2.5])), intrinsics, width, height)
        origins, directions = camera.rays()
        point = origins - (origins[..., 2:] / directions[..., 2:]) * directions
        image = torch.stack([(3 * point[..., 0]).sin(), (3 * point[..., 1]).cos(), -point[..., 0]], dim=-1) / 2 + 0.5
        normal = torch.tensor([0.0, 0, -1]).expand(height, width, 3).clone()
        views.append(View(f"view{k}", camera, (255 * image.clamp(0, 1)).byte(), normal=normal))
    points = torch.rand(250, 3, generator=generator) * torch.tensor([4.0, 3.0, 0.05]) - torch.tensor([2.0, 1.5, 0.0])
    return Scene("picture", views[1:], views[:1], points, torch.rand(250, 3, generator=generator))


def make_method(kind: str, seed: int = 0, **settings) -> Method:
    return create_method(kind, with_rules(**{**SMALL[kind], **settings}), seed=seed)


def train(method: Method, scene: Scene, steps: int = STEPS) -> list[dict[str, float]]:
    method.initialize(scene, steps)
    rows = [method.training_step(scene.train[step % len(scene.train)], step) for step in range(1, steps + 1)]
    return [{name: float(value) for name, value in row.items()} for row in rows]


@pytest.fixture(scope="module")
def trained(scene) -> dict[str, tuple[Method, list[dict[str, float]]]]:
    methods = {kind: make_method(kind) for kind in KINDS}
    return {kind: (method, train(method, scene)) for kind, method in methods.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_training_reduces_the_loss(trained, kind):
    method, losses = trained[kind]
    first, last = (sum(row["rgb"] for row in rows) / 5 for rows in (losses[:5], losses[-5:]))
    assert last < 0.6 * first
    assert losses[-1]["psnr"] > losses[0]["psnr"] + 4
    assert method.skipped_steps == 0
    assert losses[-1]["loss"] == pytest.approx(
        sum(value for name, value in losses[-1].items() if name not in ("loss", "psnr")), rel=1e-5
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_render_is_an_image_with_its_layers(trained, scene, kind):
    method, _ = trained[kind]
    camera = scene.test[0].camera
    method.prepare()
    rendering = method.render(camera)
    assert rendering.color.shape == (camera.height, camera.width, 3)
    assert not rendering.color.requires_grad
    assert torch.isfinite(rendering.color).all()
    fewer: dict[str, set[str]] = {"2dgs": set(), "3dgs": set(), "3igs": {"base", "reflection"}}
    assert set(rendering.layers) == fewer.get(kind, {"base", "reflection", "beta"})
    assert all(layer.shape[:2] == rendering.color.shape[:2] for layer in rendering.layers.values())


@pytest.mark.parametrize("kind", KINDS)
def test_a_loaded_method_renders_as_the_saved_one(trained, scene, kind, tmp_path):
    method, _ = trained[kind]
    method.save(tmp_path / "checkpoint")
    again = make_method(kind, seed=99)
    again.load(tmp_path / "checkpoint")
    again.prepare()
    method.prepare()
    camera = scene.test[0].camera
    assert torch.equal(again.render(camera).color, method.render(camera).color)
    assert again.primitives() == method.primitives()
    assert again.model_bytes() == method.model_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_counts_and_bytes(trained, kind):
    method, _ = trained[kind]
    primitives, size = method.primitives(), method.model_bytes()
    published = {"2dgs": 58, "3dgs": 59, "3dgs_dr": 60}  # of them 48 spherical harmonics, and a third scale
    published["ref_gaussian"] = 59 + 1 + 3 + 48  # roughness, albedo, and spherical harmonics of the indirect light
    published["gaussian_shader"] = 14 + 3 + 1 + 3 + 3  # tint, roughness, normals' residuals; no residual color
    published["3igs"] = 14 + 48 + 1  # features and roughness; of its color, the constant alone
    floats = published.get(kind, 38)  # of them 27 spherical harmonics, and β
    assert set(primitives) == set(size) == {"base", "env"}
    assert size["base"] == 4 * floats * primitives["base"]
    expected = dict.fromkeys(("envmap", "3dgs_dr", "ref_gaussian", "gaussian_shader"), 4 * 6 * 8 * 8 * 3)
    expected["envgs"] = 4 * 37 * primitives["env"]
    expected["3igs"] = sum(part.most_bytes() for part in method.parts.values())
    assert size["env"] == expected.get(kind, 0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_determines_a_run(scene, kind):
    first, second = make_method(kind, seed=1), make_method(kind, seed=1)
    losses = [[row["loss"] for row in train(method, scene, 20)] for method in (first, second)]
    assert losses[0] == losses[1]
    if kind in ("envgs", "ref_gaussian", "3igs"):  # environment, materials, network start at random
        assert losses[0] != [row["loss"] for row in train(make_method(kind, seed=2), scene, 20)]
    camera = scene.test[0].camera
    assert torch.equal(first.render(camera).color, second.render(camera).color)


@pytest.mark.parametrize("kind", KINDS)
def test_a_gradient_that_is_not_finite_never_reaches_adam(scene, kind):
    method = make_method(kind)
    train(method, scene, 10)
    optimizers = optimizers_of(method)
    before = [value.detach().clone() for o in optimizers for group in o.param_groups for value in group["params"]]
    states = [{k: v.clone() for k, v in o.state[p].items()} for o in optimizers for p in o.state]
    record = method.model.sets["base"].record.gradients.clone()

    damaged = dataclasses.replace(scene.train[0], normal=torch.full_like(scene.train[0].normal, float("nan")))
    if make_method(kind).settings.mono_weight == 0:  # no view's normals enter its loss: a target that is not finite
        damaged = NotFinite(**{f.name: getattr(damaged, f.name) for f in dataclasses.fields(damaged)})
    losses = method.training_step(damaged, 11)

    after = [value.detach() for o in optimizers_of(method) for group in o.param_groups for value in group["params"]]
    assert not torch.isfinite(losses["loss"])
    assert method.skipped_steps == 1
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    kept = [o.state[p] for o in optimizers_of(method) for p in o.state]
    assert all(torch.equal(a[k], b[k]) for a, b in zip(states, kept, strict=True) for k in a)
    assert torch.equal(record, method.model.sets["base"].record.gradients)
    assert torch.isfinite(method.training_step(scene.train[0], 12)["loss"])
    assert method.skipped_steps == 1


class NotFinite(View):
    def rgb(self, device="cpu"):
        return super().rgb(device) * float("nan")


def test_a_perceptual_loss_counts_once_the_harness_sets_it(scene):
    method = make_method("2dgs", perceptual_weight=0.01, perceptual_from=15_000)
    method.perceptual["features"] = lambda image, target: (image - target).square().mean()
    losses = train(method, scene, 10)
    assert ["perceptual" in row for row in losses] == [False] * 5 + [True] * 5


def test_sh_degrees_are_added_one_by_one(scene):
    method = make_method("2dgs", sh_degree=2)
    method.initialize(scene, 300)
    assert [method.model.gaussians("base", step).sh_degree for step in (1, 9, 10, 19, 20, 300)] == [0, 0, 1, 1, 2, 2]


@pytest.mark.parametrize(
    ("every", "base", "env"),
    [(1000, [0, 0, 0, 0, 1, 2], [0, 1, 2, 2, 2, 2]), (0, [0, 0, 0, 2, 2, 2], [2, 2, 2, 2, 2, 2])],
)
def test_either_set_adds_sh_degrees_from_a_step_of_its_own(scene, every, base, env):
    """In a run of 300 steps a thousand of the reference run are ten."""
    method = make_method("envgs", sh_every=every, sh_from=5_000, env_sh_from=3_000, warm_up=3_000)
    method.initialize(scene, 300)
    begin(method, 31)
    steps = (39, 40, 50, 59, 60, 70)
    assert [method.model.gaussians("base", step).sh_degree for step in steps] == base
    assert [method.model.gaussians("env", step).sh_degree for step in steps] == env


@pytest.mark.parametrize("power", [1, 2])
def test_the_environments_rate_grows_with_a_power_of_the_scene_radius(scene, power):
    rates = {}
    for size in (1.0, 3.0):
        cameras = [dataclasses.replace(view.camera, world_to_camera=scaled(view.camera, size)) for view in scene.train]
        views = [dataclasses.replace(view, camera=camera) for view, camera in zip(scene.train, cameras, strict=True)]
        method = make_method("envgs", env_radius_power=power)
        method.initialize(dataclasses.replace(scene, train=views), STEPS)
        policies, radius = method.model.policies, method.model.radius
        rates[size] = [policies[name].position_rate(1, radius) for name in ("base", "env")]
    assert rates[3.0][0] == pytest.approx(3 * rates[1.0][0], rel=1e-4)
    assert rates[3.0][1] == pytest.approx(3**power * rates[1.0][1], rel=1e-4)


def scaled(camera: Camera, size: float) -> torch.Tensor:
    """The camera's pose with its center moved away from the origin by that factor."""
    pose = camera.world_to_camera.clone()
    pose[:3, 3] *= size
    return pose


@pytest.mark.parametrize(("free_space", "expected"), [(0.0, 0.2), (0.1, 0.2), (100.0, 100.0)])
def test_nothing_is_drawn_in_the_free_space_of_a_scene(scene, tmp_path, free_space, expected):
    """The scene lies within 5 of the cameras: with a free space of 100, only the background is drawn."""
    background = torch.tensor([0.25, 0.5, 0.75])
    method = make_method("2dgs")
    method.initialize(dataclasses.replace(scene, free_space=free_space, background=background), STEPS)
    method.save(tmp_path)
    again = make_method("2dgs")
    again.load(tmp_path)
    for drawn in (method, again):
        assert drawn.model.near == expected
        image = drawn.render(scene.test[0].camera).color
        assert bool((image == background).all()) == (free_space == 100)


def test_a_scene_without_points_is_refused(scene):
    empty = dataclasses.replace(scene, points=torch.zeros(0, 3), point_colors=torch.zeros(0, 3))
    with pytest.raises(ValueError, match="picture has no points"):
        make_method("2dgs").initialize(empty, 10)


def test_cameras_at_one_place_still_have_a_scale(scene):
    lone = dataclasses.replace(scene, train=scene.train[:1])
    method = make_method("envgs")
    train(method, lone, 5)
    assert method.model.radius > 0.1


@pytest.mark.parametrize(("share", "most", "expected"), [(1.25, 1000, 540), (1.25, 300, 300), (0.1, 1000, 250)])
def test_the_base_set_has_so_many_primitives_for_each_pixel_of_a_view(scene, share, most, expected):
    """Training views of 24×18 pixels; never fewer than the 250 points that it starts from."""
    growth = {"primitives_per_pixel": share, "max_primitives": most}
    method = make_method("envmap", **growth)
    method.initialize(scene, STEPS)
    counts = []
    for step in range(1, STEPS + 1):
        method.training_step(scene.train[step % len(scene.train)], step)
        counts.append(method.primitives()["base"])
    assert max(counts) <= expected
    assert share == 0.1 or max(counts) > 250  # the bound is what holds it, not a lack of growth


@pytest.mark.parametrize(("views", "expected"), [(1, 250), (10, 432), (9_000, policy.SHAPES)])
def test_small_pictures_from_many_sides_allow_what_shapes_need(scene, views, expected):
    many = dataclasses.replace(scene, train=[scene.train[0]] * views)
    assert policy.max_base_primitives(make_method("envmap", primitives_per_pixel=0.1).settings, many) == expected


@pytest.mark.parametrize(
    ("settings", "expected"), [({}, (20_000, 30_000, 30_000)), ({"longest_run": 0}, (20_000, 30_000, 40_000))]
)
def test_a_published_baseline_trains_its_30000_steps_and_no_more(settings, expected):
    method = make_method("3dgs", **settings)
    assert tuple(method.training_steps(steps) for steps in (20_000, 30_000, 40_000)) == expected
    assert make_method("envgs").training_steps(40_000) == 40_000


def test_the_mean_of_the_criterion_is_over_the_steps_that_its_setting_says(scene):
    """A surfel too transparent to be drawn is in view all the same; one behind the camera is not."""
    camera = scene.train[0].camera
    ahead = torch.nn.functional.normalize(-camera.center, dim=0)
    points = camera.center + torch.tensor([[1.0], [2.0], [-1.0]]) * ahead
    counted = {}
    for over in ("drawn", "in_view"):
        method = make_method("2dgs", mean_gradient_over=over)
        method.initialize(dataclasses.replace(scene, points=points, point_colors=torch.rand(3, 3)), 30_000)
        base = method.model.sets["base"]
        base.parameters.replace("opacity_logits", torch.tensor([9.0, -9.0, 9.0]))
        base.parameters.replace("log_scales", torch.full((3, 2), -2.0))
        for step in (1, 2):
            method.training_step(scene.train[0], step)
        counted[over] = base.record.steps.tolist()
    assert counted == {"drawn": [2, 0, 0], "in_view": [2, 2, 0]}


def test_what_anti_aliasing_draws_grows_no_surfels_where_a_setting_says_so(scene):
    """Surfels far below a pixel, of which nothing else is drawn; as published 2DGS does not count it."""
    grows = {}
    for name, settings in {
        "published": {},
        "own": {"mean_gradient_of": "own"},
        "all": {"mean_gradient_of": "all"},
    }.items():
        method = make_method("2dgs", **settings)
        method.initialize(scene, 30_000)
        base = method.model.sets["base"]
        base.parameters.replace("log_scales", torch.full((len(base.parameters), 2), -9.0))
        method.training_step(scene.train[0], 1)
        assert (base.record.weights > 0).any()
        grows[name] = bool((base.record.gradients > 0).any())
    assert grows == {"published": False, "own": False, "all": True}


def test_the_environment_grows_by_the_way_to_each_hit_or_to_the_camera(scene):
    """Of a step: half of that way × the gradient that Adam is given."""
    camera, recorded, expected = scene.train[0].camera, {}, {}
    for way in ("hit", "camera"):
        method = make_method("envgs", warm_up=0, env_gradient=way, traced_sh_direction="ray")
        method.initialize(scene, STEPS)
        begin(method, 1)
        environment = method.model.sets["env"]
        means, given = environment.parameters.tensors["means"], {}
        start = means.detach().double()
        environment.parameters.optimizer.register_step_pre_hook(
            lambda *_, given=given, means=means: given.update(gradient=means.grad.double())
        )
        method.training_step(scene.train[0], 1)
        recorded[way] = environment.record.gradients.double()
        eye = -torch.linalg.solve(camera.world_to_camera[:3, :3].double(), camera.world_to_camera[:3, 3].double())
        expected[way] = 0.5 * (start - eye).norm(dim=1) * given["gradient"].norm(dim=1)
    assert (recorded["camera"] > 0).sum() > 10
    torch.testing.assert_close(recorded["camera"], expected["camera"], rtol=1e-4, atol=1e-12)
    assert not torch.allclose(recorded["hit"], expected["hit"], rtol=0.1, atol=0)


@pytest.mark.parametrize(("stretches", "first"), [(True, 668), (False, 600)])
def test_a_long_run_stretches_the_schedule_unless_it_is_told_not_to(scene, stretches, first):
    """The first densification after step 500 of 30,000, every 100 steps, in a run of 33,400."""
    method = make_method("2dgs", stretches=stretches)
    method.initialize(scene, 33_400)
    assert next(step for step in range(1, 1000) if "densify_base" in due(method, step)) == first


def test_the_environment_starts_in_its_box_and_on_a_sphere_around_it(scene):
    sphere = {"env_far_count": 40, "env_initial_opacity": 0.07}
    method = make_method("envgs", **sphere, warm_up=0, env_from_points=False)
    method.initialize(dataclasses.replace(scene, bounds=2.0), STEPS)
    begin(method, 1)
    tensors = method.model.sets["env"].parameters.detached()
    assert len(tensors["means"]) == 2**3 * 5 + 40
    assert tensors["means"][:-40].abs().max() <= 2
    torch.testing.assert_close(tensors["means"][-40:].norm(dim=1), torch.full((40,), 4 * 2 * 3**0.5))
    torch.testing.assert_close(tensors["opacity_logits"].sigmoid(), torch.full((80,), 0.07))
    rates = [
        next(
            group["lr"]
            for group in method.model.sets[name].parameters.optimizer.param_groups
            if group["name"] == "means"
        )
        for name in ("env", "base")
    ]
    assert rates[0] == pytest.approx(5 * rates[1])


def test_the_environment_starts_at_the_points_too(scene):
    method = make_method("envgs", env_far_count=40, warm_up=0)
    method.initialize(scene, STEPS)
    begin(method, 1)
    env, base = (method.model.sets[name].parameters.detached() for name in ("env", "base"))
    count = len(scene.points)
    assert len(env["means"]) == 2**3 * 5 + 40 + count
    assert torch.equal(env["means"][-count:], base["means"])
    assert torch.equal(env["sh_dc"][-count:], base["sh_dc"])
    assert not torch.equal(env["opacity_logits"][-count:], base["opacity_logits"])


def test_unknown_settings_are_refused_with_the_known_ones():
    with pytest.raises(
        ValueError, match=r"method envgs: env_gird: there is no such setting; there are .*Did you mean 'env_grid'"
    ):
        create_method("envgs", {"env_gird": 16})


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        ("2dgs", {"sh_degree": "two"}, "method 2dgs: sh_degree is 'two', expected a valid integer"),
        ("2dgs", {"scale_lr": True}, "method 2dgs: scale_lr is True, expected a valid number"),
        ("2dgs", {"scale_lr": -1.0}, "scale_lr is -1.0, expected greater than or equal to 0"),
        ("2dgs", {"recipe": "4dgs"}, "recipe is '4dgs', expected 'ours', '2dgs'"),
        (
            "2dgs",
            {"rules": {"normal_weighting": "far"}},
            "rules.normal_weighting is 'far', expected 'none'",
        ),
        ("envgs", {"rules": {"mono_los": "cos"}}, "rules.mono_los: there is no such setting.*Did you mean 'mono_loss'"),
        ("envmap", {"envmap_size": 1}, "envmap_size is 1, expected greater than or equal to 2"),
        ("envmap", {"envmap_doublings": 4}, "envmap_doublings is 4, expected less than or equal to 3"),
        ("ref_gaussian", {"initial_roughness": 1.0}, "initial_roughness is 1.0, expected less than 1"),
        ("envmap", {"initial_beta": 0.0}, "initial_beta is 0.0, expected greater than 0"),
        ("envmap", {"rules": {"mono_floor": 1.5}}, "rules.mono_floor is 1.5, expected less than or equal to 1"),
        ("envmap", {"beta_filter": 1.0, "joint": 1}, "beta_filter is 1.0, .*\n.*joint is 1, expected a valid boolean"),
    ],
)
def test_bad_settings_are_refused(kind, settings, message):
    with pytest.raises(ValueError, match=message):
        create_method(kind, settings)


def test_a_whole_number_may_be_written_as_1e3():
    """As YAML and Hydra's command line read it: a float."""
    given = {"densify_until": 1e3, "rules": {"average_from": 1e3, "mono_floor": 1}}
    written = {"densify_until": 1000, "rules": {"average_from": 1000, "mono_floor": 1.0}}
    for settings in (make_settings(TwoDGSSettings, given, ""), TwoDGSSettings(**given)):
        assert repr(settings.densify_until) == "1000"
        assert repr(settings.rule.average_from) == "1000"
        assert settings.rule == make_settings(TwoDGSSettings, written, "").rule
    for wrong in (1.5, float("inf"), float("nan"), "1e3"):
        with pytest.raises(ValueError, match=f"densify_until is {wrong!r}, expected a valid integer"):
            make_settings(TwoDGSSettings, {"densify_until": wrong}, "")


@pytest.mark.parametrize(
    "kind", ["4dgs", "no.such.module:Method", "envgs_bench.methods.envgs:Nothing", "pathlib:Path", ".mine:A"]
)
def test_unknown_methods_are_refused(kind):
    with pytest.raises(ValueError, match=kind.split(":")[0]):
        create_method(kind)


def test_a_method_by_import_path():
    assert set(KINDS) <= set(method_names())
    method = create_method("envgs_bench.methods.two_d_gs:TwoDGS", {"sh_degree": 1})
    assert method.settings.sh_degree == 1


def test_checkpoints_that_cannot_be_read_are_named(trained, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"model\.pt"):
        make_method("2dgs").load(tmp_path)
    trained["3dgs"][0].save(tmp_path)
    with pytest.raises(ValueError, match="holds a model of ThreeDGS, expected one of TwoDGS"):
        make_method("2dgs").load(tmp_path)
    (tmp_path / "model.pt").write_bytes((tmp_path / "model.pt").read_bytes()[:100])
    with pytest.raises(ValueError, match=r"model\.pt is not a readable checkpoint"):
        make_method("3dgs").load(tmp_path)
