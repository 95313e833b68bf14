"""`envgs-bench ply`: the sets that a run trained, as PLY files for viewers and other programs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Write the files and name them; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench ply", description="The Gaussians that a run trained, as PLY files.", allow_abbrev=False
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="one run's folder, with its checkpoint")
    parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="where <set>.ply are written")
    options = parser.parse_args(arguments)
    return explained("ply", lambda: _ply(options.run, options.out))


def _ply(run: Path, out: Path) -> int:
    for path in export_ply(run, out):
        print(path)
    return 0


def export_ply(run: Path, out: Path) -> list[Path]:
    """Write <out>/<set>.ply for each set of the run in the folder `run`; the files.

    Raises:
        ValueError, FileNotFoundError: as `reopen`, or the method has no sets of Gaussians.
    """
    from envgs_bench.methods.gaussian_method import GaussianMethod
    from envgs_bench.methods.ply import write_ply
    from envgs_bench.stored.reopening import reopen

    settings, method = reopen(run, device="cpu")
    if not isinstance(method, GaussianMethod):
        raise ValueError(f"{run}: method {settings.method.name} has no sets of Gaussians to write")
    paths = []
    for name, trained in method.sets.items():
        paths.append(out / f"{name}.ply")
        write_ply(paths[-1], trained.parameters.detached())
    return paths
