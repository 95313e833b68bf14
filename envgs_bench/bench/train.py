"""What training is worth at any time: PSNR of views that nothing is learned from, after so many steps and seconds."""

from __future__ import annotations

import csv
import gc
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rich.table import Table

from envgs_bench.core import Scene, View
from envgs_bench.memory import peak_device_bytes

from .course import Stops, Trainee, course, mean_psnr, warm_up

SHARES = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4)  # of a training, after which it stops where nobody says when
OURS, GSPLAT = "envgs-bench", "gsplat"

Row = dict[str, Any]


@dataclass(frozen=True)
class Contest:
    """What all trainings have in common."""

    scene: Scene
    views: Sequence[View]  # that are looked at, and not trained on
    scored_on: str  # test or validation
    seed: int
    device: str
    stops: Stops


@dataclass(frozen=True)
class Entry:
    """One training."""

    method: str
    by: str  # OURS or GSPLAT
    steps: int
    make: Callable[[], Trainee]

    @property
    def label(self) -> str:
        return label_of(self.by, self.method)


def entered(entry: Entry, contest: Contest) -> Iterator[Row]:
    """Train from start to end; a row at each stop.

    | key | meaning |
    |---|---|
    | dataset, scored_on, views, seed, device, steps | what it was: of so many views, a training of so many steps |
    | method, by | what was trained, and by whose program |
    | step, seconds | done so far; the clock stands still at stops |
    | psnr | the mean over the views, dB |
    | primitives | of all sets |
    | peak_bytes | the most memory of tensors on a GPU so far, training views and stops included; None on a CPU |

    A short training goes before, for nothing: whatever is compiled or imported at first use is then there.
    """
    on_gpu, device = contest.device.startswith("cuda"), contest.device
    warm_up(entry.make(), contest.scene, contest.seed, device)
    if on_gpu:
        gc.collect()
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats(device)
    trainee = entry.make()
    for step, seconds in course(trainee, contest.scene, entry.steps, contest.seed, device, contest.stops):
        yield {
            "dataset": contest.scene.name,
            "scored_on": contest.scored_on,
            "views": len(contest.views),
            "seed": contest.seed,
            "device": torch.cuda.get_device_name(device) if on_gpu else "cpu",
            **{"method": entry.method, "by": entry.by, "steps": entry.steps, "step": step, "seconds": seconds},
            "psnr": mean_psnr(trainee.picture, contest.views, device),
            "primitives": len(trainee),
            "peak_bytes": peak_device_bytes(device),
        }


def label_of(by: str, method: str) -> str:
    """What a training is called where several programs' stand together."""
    return method if by == OURS else f"{by} {method}"


def default_steps(steps: int) -> list[int]:
    """After which steps a training of so many stops where nobody says when."""
    return sorted({max(1, round(share * steps)) for share in SHARES})


def results_table(rows: Sequence[Row]) -> Table:
    """A line a stop."""
    first = rows[0]
    result = Table(title=f"{first['dataset']}: PSNR of {first['views']} {first['scored_on']} views, {first['device']}")
    for name in ("by", "method"):
        result.add_column(name)
    for name in ("step", "seconds", "PSNR dB", "primitives", "peak MiB"):
        result.add_column(name, justify="right")
    for row in rows:
        result.add_row(
            row["by"],
            row["method"],
            f"{row['step']:,} of {row['steps']:,}",
            f"{row['seconds']:.2f}",
            f"{row['psnr']:.2f}",
            f"{row['primitives']:,}",
            f"{row['peak_bytes'] / 2**20:.0f}" if row["peak_bytes"] else "",
            end_section=row["step"] == row["steps"],
        )
    return result


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """As a JSON list, or as a table where the file is a .csv."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix != ".csv":
        path.write_text(json.dumps(list(rows), indent=1) + "\n", encoding="utf-8")
        return
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)
