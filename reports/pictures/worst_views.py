"""Worst views: the test view that each kind of perturbation cost most, as it was drawn with and without."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from envgs_bench.run_folder import is_file_name, read_png_if_any, render_path, target_path

from ..numbers.stability import Case, Stability
from ..numbers.trials import Trial
from .sheets import Panel, draw_grid

MOST = 12  # kinds in a sheet, those that cost most first


@dataclass(frozen=True)
class WorstView:
    """A view of a trial whose partner drew it too."""

    kind: str
    severity: int
    method: str
    view: str
    drop: float  # in PSNR of this view, dB
    trial: Trial

    def __str__(self) -> str:
        seed = self.trial.record.seed
        return f"{self.kind} {self.severity}, {self.method}, seed {seed}, view {self.view}: −{self.drop:.1f} dB"


@dataclass(frozen=True)
class WorstViewSheet:
    """Where the worst views of a data set were drawn, relative to the report."""

    dataset: str
    path: str
    views: tuple[WorstView, ...]  # a line of the sheet each


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


def draw_worst_views(stability: Stability, out: Path, folder: str) -> list[WorstViewSheet]:
    """Write a sheet a data set that left pictures below `out`/`folder`."""
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
            written.append(WorstViewSheet(dataset, name, tuple(views)))
    return written


def _views(stability: Stability, case: Case, method: str) -> list[WorstView]:
    views = []
    for severity in stability.severities(case):
        for trial in stability.cell(case, severity, method).tried:
            if trial.partner is None or not trial.paired or not trial.run.ok:
                continue
            own, theirs = trial.run.of_views("psnr"), trial.partner.of_views("psnr")
            views += [
                WorstView(case[1], severity, method, name, theirs[name] - psnr, trial)
                for name, psnr in own.items()
                if name in theirs and is_file_name(name)
            ]
    return views


def _drawn(view: WorstView) -> list[Panel] | None:
    """Ground truth, the partner's picture and the run's; None where one is missing."""
    trial = view.trial
    if trial.partner is None:
        return None
    folder = trial.run.folder
    paths = target_path(folder, view.view), render_path(trial.partner.folder, view.view), render_path(folder, view.view)
    pictures = [read_png_if_any(path) for path in paths]
    return None if any(picture is None for picture in pictures) else [(picture, "") for picture in pictures]
