"""The core's benchmark: its workload and its rows."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch.nn.functional import max_pool2d
from trained_runs import trained_run

from envgs_bench.bench import core, peers
from envgs_bench.bench.cases import Case, chosen_cases, peer_cases, sweep_cases
from envgs_bench.bench.core import main
from envgs_bench.bench.peers import higs_drawing
from envgs_bench.bench.room import LOWER, SPHERES, UPPER, first_hits, reflected_rays, room_camera, room_gaussians
from envgs_bench.bench.rows import time_case
from envgs_bench.bench.tile_lists import tile_list_lengths
from envgs_bench.bench.tracers import compare, pixel_along
from envgs_bench.core import GaussianSet, rasterize, trace
from envgs_bench.core.backends import BACKENDS, available_backends
from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.testing import tiny_scene

KEYS = {"op", "direction", "backend", "primitives", "width", "height", "median_ms", "spread_ms", "hits_per_ray"}


def test_the_rooms_gaussians_lie_on_its_surfaces():
    """Every center is within a few deviates of a side or a sphere, and normals are those of the surface, tilted."""
    gaussians = room_gaussians(5000)
    assert len(gaussians) == 5000
    assert gaussians.sh_degree == 2
    spacing = 0.9 * (256 + 4 * torch.pi * (SPHERES[:, 3] ** 2).sum()).item() ** 0.5 / 5000**0.5
    to_sides = torch.minimum((gaussians.means - LOWER).abs(), (UPPER - gaussians.means).abs()).amin(1)
    to_spheres = ((gaussians.means[:, None] - SPHERES[:, :3]).norm(dim=2) - SPHERES[:, 3]).abs().amin(1)
    assert torch.minimum(to_sides, to_spheres).max() < 5 * 0.3 * spacing
    share = (to_spheres < to_sides).double().mean().item()
    area = 4 * torch.pi * (SPHERES[:, 3] ** 2).sum().item()
    assert share == pytest.approx(area / (256 + area), abs=0.02)
    assert gaussians.scales.log().std().item() == pytest.approx(0.6, rel=0.05)
    assert gaussians.scales.median().item() == pytest.approx(spacing, rel=0.05)

    on_floor = (gaussians.means[:, 1] < 0.1 * spacing) & (to_spheres > 3 * spacing)
    normals = rotation_matrices(gaussians.quaternions[on_floor])[:, :, 2]
    assert (normals[:, 1] > 0.7).double().mean() > 0.95


def test_the_same_seed_gives_the_same_room():
    one, other = room_gaussians(100, columns=3), room_gaussians(100, columns=3)
    assert torch.equal(one.means, other.means)
    assert one.scales.shape == (100, 3)
    assert len(room_gaussians(0)) == 0


def test_reflected_rays_start_on_surfaces_and_leave_them():
    origins, directions = (x.reshape(-1, 3) for x in reflected_rays(40, 30))
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(1200))
    inside = (origins > LOWER).all(1) & (origins < UPPER).all(1)
    outside_spheres = ((origins[:, None] - SPHERES[:, :3]).norm(dim=2) > SPHERES[:, 3]).all(1)
    assert (inside & outside_spheres).double().mean() > 0.99  # at grazing angles roughness may tip a ray inward
    distances, _ = first_hits(origins, directions)
    assert (distances > 0.02).double().mean() > 0.95


def test_first_hits_are_on_the_nearest_surface():
    camera = room_camera(16, 12)
    origins, directions = (x.reshape(-1, 3) for x in camera.rays())
    directions = torch.nn.functional.normalize(directions, dim=1)
    distances, normals = first_hits(origins, directions)
    points = origins + distances[:, None] * directions
    to_sides = torch.minimum((points - LOWER).abs(), (UPPER - points).abs()).amin(1)
    to_spheres = ((points[:, None] - SPHERES[:, :3]).norm(dim=2) - SPHERES[:, 3]).abs().amin(1)
    assert torch.minimum(to_sides, to_spheres).max() < 1e-4
    assert ((normals * directions).sum(1) < 0).all()
    for fraction in torch.linspace(0, 0.99, 20):
        on_the_way = origins + fraction * distances[:, None] * directions
        assert ((on_the_way[:, None] - SPHERES[:, :3]).norm(dim=2) > SPHERES[:, 3] - 1e-4).all()


def test_a_ray_meets_some_dozens_of_gaussians():
    hits = trace(room_gaussians(2000), *reflected_rays(16, 12), backend="torch").hits.double().mean()
    assert 20 < hits < 60


@pytest.fixture(params=[(signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)])
def ordinary_signal(request):
    """A signal as a terminal's programs have it, whoever runs the tests."""
    number, ordinary = request.param
    before = signal.signal(number, ordinary)
    yield number, ordinary
    signal.signal(number, before)


def test_what_was_timed_before_an_interruption_is_printed_and_kept(ordinary_signal, tmp_path, monkeypatch, capsys):
    number, ordinary = ordinary_signal
    timed = []

    def time_or_signal(case, *others):
        if len(timed) == 3:
            signal.raise_signal(number)
        timed.append(time_case(case, *others))
        return timed[-1]

    monkeypatch.setattr("envgs_bench.bench.rows.time_case", time_or_signal)
    arguments = ["--primitives", "50", "--size", "8x6", "--backend", "torch", "--repeats", "1"]
    assert main([*arguments, "--json", str(tmp_path / "rows.json")]) == 130
    assert json.loads((tmp_path / "rows.json").read_text()) == timed
    printed = capsys.readouterr()
    assert "rasterize_2d" in printed.out
    assert "interrupted after 3 of 6 cases" in printed.err
    assert signal.getsignal(number) is ordinary


def test_rows_are_printed_and_written(tmp_path, capsys):
    file, chart = tmp_path / "new" / "rows.json", tmp_path / "chart.png"
    arguments = ["--primitives", "50", "--size", "8x6", "12x5", "--backend", "torch", "--repeats", "3"]
    assert main([*arguments, "--json", str(file), "--chart", str(chart)]) == 0
    rows = json.loads(file.read_text())
    assert len(rows) == 3 * 2 * 2
    for row in rows:
        assert row.keys() >= KEYS
        assert row["backend"] == "torch"
        assert row["primitives"] == 50
        assert (row["width"], row["height"]) in [(8, 6), (12, 5)]
        assert row["median_ms"] > 0
        assert row["spread_ms"] >= 0
        assert row["repeats"] == 3
    assert {(row["op"], row["direction"]) for row in rows} == {
        (op, direction)
        for op in ("trace", "rasterize_2d", "rasterize_3d")
        for direction in ("forward", "forward_backward")
    }
    assert "rasterize_3d" in capsys.readouterr().out
    assert chart.read_bytes().startswith(b"\x89PNG")


def test_the_default_cases_hold_the_targets_and_the_oracle_beside_them():
    cases = chosen_cases(["cpu", "torch"], None, None)
    assert len(set(cases)) == len(cases)
    stated = {(c.op, c.direction, c.primitives, c.width, c.height) for c in cases if c.backend == "cpu"}
    assert ("trace", "forward_backward", 20_000, 160, 120) in stated
    assert ("rasterize_2d", "forward", 20_000, 640, 480) in stated
    assert ("rasterize_3d", "forward_backward", 20_000, 640, 480) in stated
    assert ("build", "forward", 300_000, None, None) in stated
    oracle = {(c.op, c.direction, c.primitives, c.width, c.height) for c in cases if c.backend == "torch"}
    assert oracle <= stated
    assert len(oracle) == 6


def test_chosen_primitives_and_sizes_are_all_that_is_timed():
    cases = chosen_cases(["cpu", "embree"], [10, 20], [(4, 3)])
    assert {c.primitives for c in cases} == {10, 20}
    assert {(c.width, c.height) for c in cases if c.op != "build"} == {(4, 3)}
    assert {c.op for c in cases if c.backend == "embree"} == {"trace"}


def test_a_sweep_covers_primitives_and_sizes_once_each():
    cases = sweep_cases(["cpu"])
    assert len(set(cases)) == len(cases)
    assert {c.primitives for c in cases if c.op == "build"} == {2_000, 6_000, 20_000, 60_000, 300_000}
    assert len({c.width for c in cases if c.op == "rasterize_2d"}) == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--size", "160"], "'160' is no size, expected WxH"),
        (["--size", "0x10"], "'0x10' is no size"),
        (["--primitives", "many"], "'many' is no positive whole number"),
        (["--primitives", "0"], "'0' is no positive whole number"),
        (["--backend", "opengl"], "invalid choice: 'opengl'"),
    ],
)
def test_bad_arguments_are_explained(arguments, message, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def test_help_knows_every_backend_and_waits_for_no_library():
    code = "import sys; from envgs_bench.bench.core import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    code += "assert not {'torch', 'numpy', 'rich'} & set(sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for name in BACKENDS:
        assert name in done.stdout


def test_three_tracers_draw_one_frame():
    """PyTorch agrees to float accuracy; one-pixel pictures but for the order of overlapping surfels."""
    rows = compare(2000, (16, 12), "cpu", 24)
    assert [row["way"] for row in rows] == ["tracer", "PyTorch", "1×1 rasterizer"]
    assert [row["rays"] for row in rows] == [192, 24, 24]
    assert rows[1]["difference"] < 1e-5
    assert 0 < rows[2]["difference"] < 0.1
    assert all(row["seconds"] > 0 for row in rows)


def test_a_camera_of_one_pixel_sees_along_its_ray():
    origin, direction = (
        torch.tensor([1.0, -2.0, 0.5]),
        torch.nn.functional.normalize(torch.tensor([0.2, 0.9, -0.4]), dim=0),
    )
    origins, directions = pixel_along(origin, direction).rays()
    torch.testing.assert_close(origins[0, 0], origin)
    torch.testing.assert_close(directions[0, 0], direction)


@pytest.mark.parametrize("direction", ["forward", "forward_backward"])
def test_an_envgs_image_and_a_training_step_are_timed(direction):
    row = time_case(Case("envgs", direction, "cpu", 100, 20, 14), repeats=3)
    assert row["repeats"] == 3
    assert row["median_ms"] > 0
    assert 0.9 < row["alpha"] <= 1  # the room is closed


def test_the_rows_of_envgs_belong_to_the_gpu():
    assert [c.direction for c in chosen_cases(["cuda"], None, None) if c.op == "envgs"] == [
        "forward",
        "forward_backward",
    ]
    assert not [c for c in chosen_cases(["cpu"], None, None) + chosen_cases(["cuda"], [10], None) if c.op == "envgs"]


@pytest.mark.skipif(available_backends()["cuda"] is not None, reason="needs the cuda backend")
@pytest.mark.parametrize("op", ["rasterize_2d_color", "rasterize_3d_color"])
def test_a_picture_of_color_alone_is_timed_on_cuda(op):
    row = time_case(Case(op, "forward", "cuda", 300, 64, 48), repeats=3)
    assert row["median_ms"] > 0
    assert 0.9 < row["alpha"] <= 1
    assert 0 < row["lists_p50"] <= row["lists_max"] <= 300


def test_peers_are_asked_for_what_they_can_draw():
    cases = chosen_cases(["cuda", "cpu"], None, None)
    asked = peer_cases(cases, ["gsplat", "higs"])
    assert {(c.backend, c.op, c.direction) for c in asked} == {
        ("gsplat", "rasterize_2d", "forward"),
        ("gsplat", "rasterize_2d", "forward_backward"),
        ("gsplat", "rasterize_3d", "forward"),
        ("gsplat", "rasterize_3d", "forward_backward"),
        ("higs", "rasterize_3d_color", "forward"),
    }
    assert {replace(c, backend="cuda") for c in asked} <= set(cases)
    assert not peer_cases(cases, [])


def test_only_peers_that_could_be_asked_are_missed(monkeypatch, capsys):
    monkeypatch.setattr(peers, "why_unavailable", {"gsplat": None, "higs": "higs: no such package"}.get)

    def found(*operations):
        return core._peers(chosen_cases(["cuda"], None, None, operations))

    assert found("rasterize_2d") == ["gsplat"]
    assert not capsys.readouterr().err
    assert found("rasterize_3d", "rasterize_3d_color") == ["gsplat"]
    assert "left out, higs: no such package" in capsys.readouterr().err
    with pytest.raises(ValueError, match="--peers: higs: no such package"):
        found("rasterize_3d_color")
    with pytest.raises(ValueError, match="needs the cuda backend, and some of rasterize_2d, rasterize_3d, rast"):
        found("trace")


def test_higs_is_told_of_unit_quaternions_and_answers_with_transmittance(monkeypatch):
    """A stand-in for its two classes: what it is given, and that its fourth channel becomes alpha."""
    told = {}

    class Scene:
        @staticmethod
        def from_gaussian_tensors(means, quaternions, scales, opacities, sh, degree, compression, id):
            told.update(quaternions=quaternions, degree=degree, compression=compression)
            return id

    class Renderer:
        def __init__(self, scene):
            self.scene = scene

        def render(self, *, viewmat, K, width, height, near_plane):
            told.update(viewmat=viewmat, K=K, near=near_plane, inference=torch.is_inference_mode_enabled())
            frame = torch.full((1, height, width, 4), 0.25, dtype=torch.half)
            return SimpleNamespace(frame=frame)

    stand_in = SimpleNamespace(GaussianInferenceScene=Scene, GaussianInferenceRenderer=Renderer)
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(experimental=stand_in))
    monkeypatch.setitem(sys.modules, "gsplat.experimental", stand_in)
    room, camera = room_gaussians(20, columns=3), room_camera(8, 6)
    room = replace(room, quaternions=2 * room.quaternions)
    drawn = higs_drawing(room, camera, 0.2)()
    assert drawn.color.shape == (6, 8, 3)
    assert torch.equal(drawn.alpha.float(), torch.full((6, 8), 0.75))
    torch.testing.assert_close(told["quaternions"].norm(dim=1), torch.ones(20))
    assert (told["degree"], told["compression"], told["near"], told["inference"]) == (2, "none", 0.2, True)
    assert torch.equal(told["viewmat"], camera.world_to_camera)


def test_color_alone_is_timed_without_gradients_and_on_a_gpu():
    row = time_case(Case("trace_color", "forward", "cpu", 100, 20, 14), repeats=3)
    assert row["median_ms"] > 0
    assert row["hits_per_ray"] > 1
    assert {c.direction for c in chosen_cases(["cuda"], None, None) if c.op == "trace_color"} == {"forward"}
    assert not [c for c in chosen_cases(["cpu", "torch"], None, None) if c.op == "trace_color"]


@pytest.mark.parametrize("op", ["adam", "ssim", "cubemap", "2dgs", "3dgs", "envmap"])
def test_what_a_training_step_takes_is_timed_alone(op):
    width, height = (None, None) if op == "adam" else (20, 14)
    primitives = 0 if op in ("ssim", "cubemap") else 60
    direction = "forward" if op == "adam" else "forward_backward"
    row = time_case(Case(op, direction, "cpu", primitives, width, height), repeats=3)
    assert row["repeats"] == 3
    assert row["median_ms"] > 0
    assert (row["alpha"] is not None) == (op in ("2dgs", "3dgs", "envmap"))
    assert row["peak_bytes"] is None  # of a GPU


def test_a_backend_is_asked_for_what_it_has():
    default = {backend: {c.op for c in chosen_cases([backend], None, None)} for backend in ("cpu", "cuda", "torch")}
    assert {"adam", "ssim", "cubemap", "prefiltered"} <= default["cpu"] & default["cuda"]
    assert {"trace_color", "rasterize_3d_color", "2dgs", "3dgs", "envmap"} <= default["cuda"] - default["cpu"]
    assert default["torch"] == {"trace", "rasterize_2d", "rasterize_3d"}
    chosen = chosen_cases(["cpu", "torch"], [10], [(4, 3)], ["envgs", "ssim", "trace_color"])
    assert {(c.op, c.backend, c.primitives) for c in chosen} == {("envgs", "cpu", 10), ("ssim", "cpu", 0)}


def test_rows_say_how_many_hits_and_how_long_lists_are():
    """Against the hits that the oracle counts: their distribution, and that no pixel has more than its tile's list."""
    row = time_case(Case("rasterize_2d", "forward", "cpu", 300, 32, 16), repeats=3)
    hits = rasterize(room_gaussians(300), room_camera(32, 16), backend="torch").hits
    assert row["hits_per_ray"] == pytest.approx(hits.double().mean().item(), rel=1e-3)
    assert abs(row["hits_max"] - hits.max()) <= 1
    assert row["hits_p50"] <= row["hits_p99"] <= row["hits_max"] <= row["lists_max"] <= 300
    assert row["lists_p50"] <= row["lists_p99"]


def spots(camera, centers):
    """Small opaque surfels that face the camera at pixel positions, at depth 2."""
    x, y = torch.tensor(centers).T
    at = torch.stack([x, y, torch.ones_like(x)], dim=1) @ camera.intrinsics.inverse().T * 2
    in_world = (at - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]
    turned = torch.tensor([[1.0, 0, 0, 0]]).repeat(len(centers), 1)
    count = len(centers)
    return GaussianSet(
        in_world, turned, torch.full((count, 2), 1e-3), torch.full((count,), 0.9), torch.zeros(count, 1, 3)
    )


def test_a_tiles_list_holds_what_lies_in_it():
    camera = replace(room_camera(48, 32), world_to_camera=torch.eye(4))
    drawn = spots(camera, [(8.0, 8.0), (24.0, 8.0), (25.0, 9.0), (40.0, 24.0)])
    assert tile_list_lengths(drawn, camera, 0.2, "cpu").tolist() == [1, 2, 0, 0, 0, 1]


@pytest.mark.parametrize("columns", [2, 3])
def test_tiles_that_a_slanted_primitive_misses_do_not_list_it(columns):
    """Against the oracle's hits: its box lies in all twelve tiles, itself in some."""
    camera = replace(room_camera(64, 48), world_to_camera=torch.eye(4))
    half = math.pi / 8
    turned = torch.tensor([[math.cos(half), 0, 0, math.sin(half)]])  # by 45° about the viewing direction
    scales = torch.tensor([[0.5, 0.01, 0.01]])[:, :columns]
    thin = GaussianSet(torch.tensor([[0.0, 0.0, 2.0]]), turned, scales, torch.full((1,), 0.9), torch.zeros(1, 1, 3))
    hits = rasterize(thin, camera, near=0.2, backend="torch").hits
    seen = max_pool2d(hits[None].float(), 16)[0].flatten()
    assert 3 < seen.sum() < 9
    assert tile_list_lengths(thin, camera, 0.2, "cpu").tolist() == seen.tolist()


def test_a_trained_run_is_timed_on_its_own_views(tmp_path, capsys):
    method = trained_run(tmp_path / "run", "envgs", steps=4, warm_up=0, env_grid=2, env_far_count=8)
    file = tmp_path / "rows.json"
    arguments = ["--scene", str(tmp_path / "run"), "--backend", "cpu", "--repeats", "1", "--views", "1"]
    assert main([*arguments, "--json", str(file)]) == 0
    rows = {(row["op"], row["direction"]): row for row in json.loads(file.read_text())}
    counts, view = method.primitives(), tiny_scene().test[0]
    assert {op for op, _ in rows} == {"rasterize_2d", "trace", "build", "adam", "ssim", "envgs"}
    assert rows["rasterize_2d", "forward"]["primitives"] == counts["base"]
    assert rows["trace", "forward"]["primitives"] == rows["build", "forward"]["primitives"] == counts["env"]
    assert rows["envgs", "forward_backward"]["primitives"] == sum(counts.values())
    drawn = method.model.rasterize(view.camera, None)
    assert rows["rasterize_2d", "forward"]["hits_per_ray"] == pytest.approx(drawn.hits.double().mean().item())
    assert rows["envgs", "forward"]["alpha"] == pytest.approx(drawn.alpha.mean().item())
    assert (rows["trace", "forward"]["width"], rows["trace", "forward"]["height"]) == (
        view.camera.width,
        view.camera.height,
    )
    assert "tiny/envgs/run" in capsys.readouterr().out
    assert main(["--scene", str(tmp_path / "run"), "--backend", "embree", "--op", "envgs"]) == 1  # it has a backend
    assert "and a backend that has them" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--op", "sorting"], "--op sorting: expected some of trace, "),
        (["--op", "trace_color", "--backend", "cpu"], "and a backend that has them"),
        (["--peers", "--backend", "cpu"], "--peers: needs the cuda backend"),
        (["--scene", "nowhere"], "nowhere: holds no config.yaml"),
        (["--scene", "nowhere", "--size", "8x6"], "a run has its own primitives and sizes"),
    ],
)
def test_what_cannot_be_timed_is_refused(arguments, message, capsys):
    assert main(arguments) == 1
    assert message in capsys.readouterr().err
