"""`envgs-bench ply`: the sets that a run trained, as PLY files for viewers and other programs."""

from __future__ import annotations

from pathlib import Path

from .methods.gaussian_method import GaussianMethod
from .methods.ply import write_ply
from .reopening import reopen


def export_ply(run: Path, out: Path) -> list[Path]:
    """Write <out>/<set>.ply for each set of the run in the folder `run`; the files.

    Raises:
        ValueError, FileNotFoundError: as `reopen`, or the method has no sets of Gaussians.
    """
    settings, method = reopen(run, device="cpu")
    if not isinstance(method, GaussianMethod):
        raise ValueError(f"{run}: method {settings.method.name} has no sets of Gaussians to write")
    paths = []
    for name, trained in method.sets.items():
        paths.append(out / f"{name}.ply")
        write_ply(paths[-1], trained.parameters.detached())
    return paths
