"""Made-up run folders for the reports' tests. The numbers are drawn from a generator and the pictures are a ball in a
box, ray traced in ten lines; no method ever ran. `write_runs` leaves what finished runs leave, `write_failure` what
failed ones do."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from envgs_bench.reports.numbers.runs import read_runs
from envgs_bench.reports.report import chapter_of, studies_of
from envgs_bench.reports.tables.chapter import Chapter
from envgs_bench.reports.tables.entries import headings
from envgs_bench.reports.tables.sections import Section, split_sections
from envgs_bench.reports.tables.table import Row, Table

CONTRACT = "render(camera) to an image in memory, every view warmed up once, at least 50 frames or 1 s a view"
PROTOCOL = {
    "name": "envgs",
    "hash": "5e1f00d0c0ffee11",
    "description": "float renders; PSNR a mean of per-image values; SSIM 11×11, σ 1.5, zero padding; masks on white",
}
# PSNR, how much worse on the reflective region, frame ms, training s, base and env primitives, blur, layers
METHODS: dict[str, tuple[float, float, float, float, int, int, float]] = {
    "3dgs": (26.9, 5.2, 9.1, 21.0, 14_200, 0, 3.0),
    "2dgs": (26.4, 5.9, 17.5, 27.0, 12_800, 0, 4.0),
    "envmap": (27.8, 4.4, 24.0, 39.0, 12_300, 0, 1.8),
    "envgs": (29.6, 2.6, 61.0, 66.0, 12_100, 3_400, 0.8),
}
KINDS = {
    **dict.fromkeys(("envgs_paper", "envgs_paper_no_joint", "envgs_paper_no_mono_normal", "envgs_no_joint"), "envgs"),
    "envmap_paper": "envmap",
}
ORDER = ("3dgs", "2dgs", "2dgs_tuned", "envmap_paper", "envmap", "envgs_paper", "envgs", "envgs_no_joint")
CARDS: dict[str, dict[str, Any]] = {
    name: {"family": name.partition("_")[0], "order": order, "label": name, "color": "", "reflects": order > 2}
    for order, name in enumerate((*ORDER, "envgs_paper_no_joint"))
}
PARTS = {"2dgs_tuned": "", "envmap": "environment map", "envgs_no_joint": "environment Gaussians", "envgs": "joint"}
PUBLISHED = {
    **{"3dgs": "3DGS", "2dgs": "2DGS", "envgs_paper": "EnvGS", "envmap_paper": "w/ environment map"},
    "envgs_paper_no_joint": "w/o joint optimization",
}
for step, (name, adds) in enumerate(PARTS.items()):
    CARDS[name] |= {"ladder": "envgs", "step": step, "adds": adds}
for name, published in PUBLISHED.items():
    CARDS[name]["published"] = published
for name, whole in {"envmap": "envgs", "envmap_paper": "envgs_paper", "envgs_paper_no_joint": "envgs_paper"}.items():
    CARDS[name]["variant_of"] = whole
DATASETS = {"toy/chrome_room": 0.0, "toy/sky_ball": 3.1, "toy/diffuse_room": 5.4}
VIEWS = 5


def write_runs(
    folder: Path,
    datasets: tuple[str, ...] = ("toy/chrome_room",),
    methods: tuple[str, ...] = tuple(METHODS),
    seeds: tuple[int, ...] = (0, 1, 2),
    size: tuple[int, int] = (60, 80),
    pictures: bool = True,
    **changes: Any,
) -> None:
    """One finished run a data set, method and seed; `changes` replace keys of every record. Size is (height, width)."""
    for dataset in datasets:
        for method in methods:
            for seed in seeds:
                run = run_folder(folder, dataset, method, seed)
                write_record(run, record(dataset, method, seed, size, **changes))
                (run / "curve.csv").write_text(_curve(dataset, method, seed))
                if pictures:
                    _write_pictures(run, method, size)


def write_failure(
    folder: Path, dataset: str, method: str, seed: int, status: str, message: str, **changes: Any
) -> None:
    error = {
        "type": "RuntimeError",
        "message": message,
        "log_tail": f"step 412  loss 0.183\nstep 413  loss nan\n{message}",
    }
    empty: dict[str, Any] = {"metrics": None, "masked": {}, "timing": None, "cost": None}
    content = record(dataset, method, seed, **({"status": status, "error": error} | empty | changes))
    write_record(run_folder(folder, dataset, method, seed), content)


def run_folder(folder: Path, dataset: str, method: str, seed: int) -> Path:
    safe = method.replace("/", "_")
    return folder / dataset / safe / f"seed{seed}-{zlib.crc32(f'{dataset} {method} {seed}'.encode()):08x}"


def write_record(run: Path, content: dict[str, Any]) -> None:
    run.mkdir(parents=True, exist_ok=True)
    (run / "record.json").write_text(json.dumps(content), encoding="utf-8")
    (run / "config.yaml").write_text(f"method: {{name: {json.dumps(content['method'])}}}\n")
    (run / "log.txt").write_text("made up\n")


def record(dataset: str, method: str, seed: int, size: tuple[int, int] = (60, 80), **changes: Any) -> dict[str, Any]:
    """A whole record with made-up numbers around those of `METHODS`, the same at every call."""
    random = np.random.default_rng(zlib.crc32(f"{dataset} {method} {seed}".encode()))
    psnr, reflective, frame_ms, train, base, env, _ = METHODS.get(method, (25.0, 5.0, 30.0, 40.0, 9_000, 0, 3.0))
    psnr += DATASETS.get(dataset, 0.0) * (0.4 if env else 0.6) + random.normal(0, 0.12)
    views = [
        {"view": f"{i:03d}", "psnr": psnr + offset, "ssim": 0.9, "flip": 0.1, "lpips": None}
        for i, offset in enumerate(np.linspace(-1.6, 1.6, VIEWS))
    ]
    scores = {"psnr": psnr, "ssim": 0.62 + psnr / 100, "flip": 0.36 - psnr / 110, "lpips": None}
    regions = {"reflective": reflective, "near_field": reflective + 0.9} if "diffuse" not in dataset else {}
    sets = {"base": base + int(random.integers(300))} | ({"env": env} if env else {})
    return {
        "schema_version": 1,
        "status": "ok",
        "error": None,
        "method": method,
        "kind": KINDS.get(method, method),
        "card": CARDS.get(method),
        "dataset": dataset,
        "seed": seed,
        "steps": 1500,
        "run_id": f"{zlib.crc32(f'{dataset} {method} {seed}'.encode()):08x}",
        "overrides": [f"method={method}", f"dataset={dataset}", f"seed={seed}"],
        "config": {"method": {"name": method}, "dataset": {"kind": "toy", "views": 40}, "steps": 1500},
        "protocol": PROTOCOL,
        "metrics": {
            "mean": scores,
            "per_view": views,
            "not_computed": {"lpips": "no VGG-16 weights on this machine"},
        },
        "masked": {
            name: {"psnr": psnr - loss, "ssim": 0.8, "flip": 0.2, "lpips": None, "fraction": 0.18, "per_view": []}
            for name, loss in regions.items()
        },
        "timing": {
            "frame_ms": frame_ms * random.normal(1, 0.02),
            "frame_ms_p95": frame_ms * 1.2,
            "fps": 1000 / frame_ms,
            "prepare_ms": 3.0,
            "height": size[0],
            "width": size[1],
            "per_view": [],
            "contract": CONTRACT,
        },
        "cost": {
            "primitives": sets,
            "bytes": {name: count * 148 for name, count in sets.items()},
            "model_bytes": sum(sets.values()) * 148,
            "train_seconds": train * random.normal(1, 0.03),
            "peak_host_bytes": 900_000_000,
            "peak_device_bytes": None,
            "skipped_steps": 0,
            "peak_primitives": sum(sets.values()) + 900,
        },
        "provenance": {
            "version": "0.1.0",
            "commit": "0123456789abcdef0123456789abcdef01234567",
            "dirty": False,
            "python": "3.11.7",
            "packages": {"torch": "2.13.0", "numpy": "2.4.6"},
            "machine": {"system": "made up", "cpu": "made-up CPU"},
            "device": {"type": "cpu", "name": "made-up CPU"},
            "threads": 2,
            "started": "2026-01-01T10:00:00+00:00",
            "finished": "2026-01-01T10:01:00+00:00",
            "command": f"envgs-bench run method={method} dataset={dataset} seed={seed}",
        },
    } | changes


def _curve(dataset: str, method: str, seed: int) -> str:
    random = np.random.default_rng(zlib.crc32(f"{dataset} {method} {seed} curve".encode()))
    psnr, _, _, _, base, env, _ = METHODS.get(method, (25.0, 5.0, 30.0, 40.0, 9_000, 0, 3.0))
    lines = ["step,seconds,loss,psnr,skipped_steps,primitives_base" + (",primitives_env" if env else "")]
    for step in range(50, 1501, 50):
        share = 1 - np.exp(-step / 350)
        value = 12 + (psnr - 12) * share + random.normal(0, 0.15)
        counts = [int(count * share) for count in (base, env) if count]
        skipped = step // 400 * seed
        row = [step, step / 50, f"{0.3 * (1 - share) + 0.02:.4f}", f"{value:.3f}", skipped, *counts]
        lines.append(",".join(map(str, row)))
    return "\n".join(lines) + "\n"


def _write_pictures(run: Path, method: str, size: tuple[int, int]) -> None:
    blur = METHODS.get(method, (3.0,))[-1]
    for index in range(VIEWS):
        name, angle = f"{index:03d}", 0.5 * index - 1
        parts = ball_in_a_box(size, angle)
        far = ball_in_a_box(size, angle, parallax=method != "envmap")
        width = blur * size[1] / 320
        base = gaussian_filter(parts["base"], (width / 3, width / 3, 0))
        reflection = gaussian_filter(far["reflection"], (width, width, 0))
        beta = gaussian_filter(parts["beta"], (width / 3, width / 3, 0))
        picture = (1 - beta) * base + beta * reflection
        target = (1 - parts["beta"]) * parts["base"] + parts["beta"] * parts["reflection"]
        _save(run / "targets" / f"{name}.png", target)
        _save(run / "renders" / f"{name}.png", picture)
        _save(run / "masks/reflective" / f"{name}.png", parts["beta"] > 0)
        if method in ("envmap", "envgs"):
            error = np.abs(picture - target).mean(-1, keepdims=True) * 4
            layers = {"base": base, "reflection": reflection, "beta": beta, "normal": parts["normal"], "error": error}
            for layer, image in layers.items():
                _save(run / "layers" / layer / f"{name}.png", image)


def ball_in_a_box(size: tuple[int, int], angle: float, parallax: bool = True) -> dict[str, np.ndarray]:
    """base, reflection, beta, normal, each [H, W, 1 or 3] in [0, 1]: a chrome ball seen from `angle`, radians."""
    height, width = size
    y, x = np.mgrid[0.5:height, 0.5:width]
    directions = np.stack([(x - width / 2) / width, (y - height / 2) / width, np.full_like(x, 0.75)], -1)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    directions = directions @ turn.T / np.linalg.norm(directions, axis=-1, keepdims=True)
    origin = turn @ np.array([0.0, -0.1, -2.4])
    b = directions @ origin
    inside = b**2 - (origin @ origin - 0.8**2)
    hit = (inside > 0)[..., None]
    points = origin + (-b - np.sqrt(np.maximum(inside, 0)))[..., None] * directions
    normals = points / np.linalg.norm(points, axis=-1, keepdims=True)
    mirrored = directions - 2 * (directions * normals).sum(-1, keepdims=True) * normals
    base = np.where(hit, [0.16, 0.17, 0.2], _box(origin, directions))
    reflection = np.where(hit, _box(points if parallax else points * 0, mirrored), 0)
    return {"base": base, "reflection": reflection, "beta": 0.85 * hit, "normal": np.where(hit, normals / 2 + 0.5, 0.5)}


def _box(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The color of a patterned box of half side 3 seen from within."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(directions > 0, (3 - origins) / directions, (-3 - origins) / directions)
    wall = np.argmin(t, -1)
    points = origins + t.min(-1)[..., None] * directions
    tiles = (np.floor(points * 1.5).sum(-1) % 2)[..., None]
    colors = np.array([[0.75, 0.35, 0.25], [0.85, 0.8, 0.7], [0.25, 0.45, 0.6]])[wall]
    lamp = ((wall == 1) & (points[..., 1] < 0) & (np.abs(points[..., 0]) < 1.2))[..., None]
    return np.where(lamp, 1.0, colors * (0.55 + 0.45 * tiles))


def _save(path: Path, image: np.ndarray) -> None:
    pixels = np.broadcast_to(image, (*image.shape[:2], 3))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((np.clip(pixels, 0, 1) * 255 + 0.5).astype(np.uint8)).save(path)


def sections_of(folder: Path) -> list[Section]:
    return split_sections(read_runs(folder)[0])


def chapter(section: Section) -> Chapter:
    return chapter_of(section, studies_of(section))


def row_of(table: Table, method: str) -> Row:
    return next(row for row in table.rows if row.method == method)


def tables_of(section: Section) -> list[Table]:
    """The section's tables and those of its studies."""
    return chapter(section).tables


def titled(section: Section, title: str) -> Table:
    return next(table for table in tables_of(section) if table.title == title)


def titles(table: Table) -> list[str]:
    return [heading.full for heading in headings(table)]
