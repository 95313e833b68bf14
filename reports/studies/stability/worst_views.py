"""Worst views: the test view that each kind of perturbation cost most, as it was drawn with and without."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from envgs_bench.run_folder import is_file_name, read_png_if_any, render_path, target_path

from ...charts.drawn import DrawnChart
from ...pictures.sheets import Panel, draw_grid
from .perturbed_runs import PerturbedRun
from .stability import Case, Stability

MOST = 12  # kinds in a sheet, those that cost most first


@dataclass(frozen=True)
class WorstView:
    """A view of a perturbed run whose partner drew it too."""

    kind: str
    severity: int
    method: str
    view: str
    drop: float  # in PSNR of this view, dB
    run: PerturbedRun

    def __str__(self) -> str:
        seed = self.run.record.seed
        return f"{self.kind} {self.severity}, {self.method}, seed {seed}, view {self.view}: −{self.drop:.1f} dB"


def worst_views(stability: Stability, dataset: str) -> list[WorstView]:
    """Of each kind and method the view with the largest drop that has pictures, the largest first."""
    found = []
    for case in stability.cases:
        if case[0] == dataset:
            for method in stability.methods_of(case):
                views = _views(stability, case, method)
                shown = (v for v in sorted(views, key=lambda v: -v.drop) if v.drop > 0 and _drawn(v) is not None)
                if (worst := next(shown, None)) is not None:
                    found.append(worst)
    return sorted(found, key=lambda view: -view.drop)[:MOST]


def draw_worst_views(stability: Stability, out: Path, folder: str) -> list[DrawnChart]:
    """Write a sheet a data set that left pictures below `out`/`folder`; its title says which views it shows."""
    written = []
    for number, dataset in enumerate(stability.datasets):
        views = worst_views(stability, dataset)
        lines = [(f"{view.kind} {view.severity}: {view.method}", _drawn(view) or []) for view in views]
        if lines:
            first = lines[0][1][0][0]
            aspect = first.shape[0] / first.shape[1] if first is not None else 1.0
            name = f"{folder}/worst-views-{number}.png"
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            draw_grid(["ground truth", "unperturbed", "perturbed"], [""] * 3, lines, aspect).save(out / name)
            written.append(DrawnChart(name, f"{dataset}: {'; '.join(map(str, views))}"))
    return written


def _views(stability: Stability, case: Case, method: str) -> list[WorstView]:
    views = []
    for severity in stability.severities(case):
        for run in stability.cell(case, severity, method).tried:
            if run.partner is None or not run.paired or not run.run.ok:
                continue
            own, theirs = run.run.of_views("psnr"), run.partner.of_views("psnr")
            views += [
                WorstView(case[1], severity, method, name, theirs[name] - psnr, run)
                for name, psnr in own.items()
                if name in theirs and is_file_name(name)
            ]
    return views


def _drawn(view: WorstView) -> list[Panel] | None:
    """Ground truth, the partner's picture and the run's; None where one is missing."""
    run = view.run
    if run.partner is None:
        return None
    folder = run.run.folder
    paths = target_path(folder, view.view), render_path(run.partner.folder, view.view), render_path(folder, view.view)
    pictures = [read_png_if_any(path) for path in paths]
    return None if any(picture is None for picture in pictures) else [(picture, "") for picture in pictures]
