"""The core's benchmark: its workload and its rows."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
import torch

from envgs_bench.bench.cases import Case, chosen_cases, sweep_cases, time_case
from envgs_bench.bench.core import main
from envgs_bench.bench.room import LOWER, SPHERES, UPPER, first_hits, reflected_rays, room_camera, room_gaussians
from envgs_bench.bench.tracers import compare, pixel_along
from envgs_bench.core import trace
from envgs_bench.core.backends import BACKENDS
from envgs_bench.core.torch.rotation import rotation_matrices

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
