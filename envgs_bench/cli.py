"""The command line. Parses here, imports where the work is: `--help` answers without waiting for PyTorch."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

RUN_HELP = """\
Train, render, score and time methods on data sets; one folder and one record.json a run.

  envgs-bench run method=envgs dataset=toy/chrome_room
  envgs-bench run -m method=2dgs,3dgs,envmap,envgs seed=0,1,2      every combination, one after the other
  envgs-bench run -m experiment=demo                               a prepared sweep
  envgs-bench run dataset=colmap dataset.root=FOLDER steps=3000    a capture of your own
  envgs-bench run dataset=ref_real/sedan data_root=FOLDER          a scene of the paper, below FOLDER
  envgs-bench run method=renders path=FOLDER method.name=other     test views that another program drew

Keys of every run:
  method, dataset     see `envgs-bench list`; their settings are method.settings.<key>=, dataset.<key>=
  protocol, seed, steps, device=auto|cpu|cuda
  runs_dir=runs, cache_dir, timeout_minutes, timing.frames, timing.seconds
  force=true          run again what is already there, replacing it
  retry_failed=true   run again what ended with another status than ok

Hydra's own options work too: -m, --cfg job (show the composed configuration), --config-dir DIR (more methods and
data sets as YAML files), hydra/launcher=joblib (jobs in parallel).

Exit status: 0 all runs ok, 1 some not, 2 wrong arguments, 130 interrupted.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """The `envgs-bench` command; returns its exit status."""
    # OpenMP reads this as PyTorch is loaded, here and in the runs started from here. Threads that wait by spinning cost
    # a run beside another (a parallel sweep, a shared machine) ten times its own time.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    options, rest = _parser().parse_known_args(arguments)
    if rest and options.command not in ("run", "bench", "export"):
        _parser().error(f"unrecognized arguments: {' '.join(rest)}")
    if options.command == "run":
        from .app import run

        return run(rest)
    if options.command == "report":
        return _report(options.runs, options.out)
    if options.command == "rescore":
        return _explained("rescore", lambda: _rescore(options))
    if options.command == "masks":
        return _explained("masks", lambda: _masks(options))
    if options.command == "ply":
        return _explained("ply", lambda: _ply(options.run, options.out))
    if options.command == "export":
        return _explained("export", lambda: _export(rest, options.format, options.out))
    if options.command == "bench":
        return _bench(options.subject, rest)
    if options.command == "list":
        from .listing import print_listing

        return print_listing()
    from .doctor import examine

    return examine()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="envgs-bench",
        description="Benchmark novel-view synthesis of reflective scenes: speed, accuracy, stability, size.",
        allow_abbrev=False,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser(
        "run",
        help="train, render, score and time; `run --help` tells the keys",
        description=RUN_HELP,
        usage="envgs-bench run [-m] [KEY=VALUE ...]",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    report = commands.add_parser("report", help="tables, charts and pages from records")
    report.add_argument("runs", type=Path, metavar="RUNS", help="a folder with runs: the runs_dir of `run`")
    report.add_argument("--out", type=Path, metavar="DIR", help="where to write; RUNS/report by default")
    rescore = commands.add_parser("rescore", help="finished runs under another protocol, without training them again")
    rescore.add_argument("runs", type=Path, metavar="RUNS", help="a folder with runs, or one run's")
    rescore.add_argument("--protocol", required=True, metavar="NAME", help="`envgs-bench list` names them")
    rescore.add_argument("--out", type=Path, metavar="DIR", help="where records go; RUNS-<protocol> by default")
    rescore.add_argument(
        "--redraw",
        action="store_true",
        help="draw the views again from the checkpoints, instead of taking the 8-bit pictures that runs left: "
        "for protocols that score floats, and for masks added since; needs the data",
    )
    rescore.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="of --redraw")
    masks = commands.add_parser("masks", help="masks of what reflects, from an EnvGS that was trained on a capture")
    masks.add_argument("run", type=Path, metavar="RUN", help="the folder of one run of method=envgs")
    masks.add_argument(
        "--region",
        required=True,
        choices=["reflective", "near_field"],
        help="reflective: what reflects, made as in the EnvGS paper; near_field: what reflects near things, our own",
    )
    masks.add_argument(
        "--out", type=Path, metavar="DIR", required=True, help="masks_<region>/ goes here; the capture's folder uses it"
    )
    masks.add_argument(
        "--beta", type=float, default=0.2, metavar="B", help="a primitive reflects where its β is above (default 0.2)"
    )
    masks.add_argument(
        "--foreground",
        type=float,
        nargs=4,
        metavar=("X", "Y", "Z", "RADIUS"),
        help="the ball that holds the foreground, world units; by default what the cameras stand around",
    )
    masks.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    ply = commands.add_parser("ply", help="the Gaussians that a run trained, as PLY files")
    ply.add_argument("run", type=Path, metavar="RUN", help="one run's folder, with its checkpoint")
    ply.add_argument("--out", type=Path, metavar="DIR", required=True, help="where <set>.ply are written")
    export = commands.add_parser(
        "export",
        help="a data set in COLMAP's or blender's layout",
        usage="envgs-bench export [KEY=VALUE ...] --format FORMAT --out DIR",
        description="Write a data set, given as for `run`: dataset=toy/glass dataset.width=320",
        allow_abbrev=False,
    )
    export.add_argument("--format", choices=["colmap", "colmap-text", "blender"], default="colmap")
    export.add_argument("--out", type=Path, metavar="DIR", required=True, help="a new folder")
    commands.add_parser("list", help="methods, data sets, protocols, experiments, backends")
    bench = commands.add_parser("bench", help="time the core itself", add_help=False, allow_abbrev=False)
    bench.add_argument(
        "subject", choices=["core", "tracers"], help="what to time; `bench core --help` tells its options"
    )
    commands.add_parser("doctor", help="what works on this machine, and why not what does not")
    return parser


def _bench(subject: str, arguments: list[str]) -> int:
    if subject == "tracers":
        from .bench.tracers import main as bench_tracers

        return bench_tracers(arguments)
    from .bench.core import main as bench_core

    return bench_core(arguments)


def _report(runs: Path, out: Path | None) -> int:
    """Write the report; the exit status is 1 where nothing was written or a record is missing from it."""
    from .reports import build_report

    try:
        report = build_report(runs, out or runs / "report")
    except (OSError, ValueError) as error:
        print(f"envgs-bench report: {error}", file=sys.stderr)
        return 1
    print(report)
    for record in report.broken:
        print(f"envgs-bench report: {record.path}: {record.reason}", file=sys.stderr)
    return int(bool(report.broken))


def _rescore(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import track

    from .metrics import get_protocol
    from .records import find_records
    from .rescoring import redraw, rescore

    runs, protocol = options.runs, get_protocol(options.protocol)
    out = options.out or Path(f"{runs.resolve()}-{options.protocol}")
    folders = [path.parent for path in find_records(runs) if out.resolve() not in path.resolve().parents]
    names, problems = set(), []
    for folder in track(folders, "scoring", console=Console(stderr=True), transient=True):
        below = folder.relative_to(runs)
        target = out / (folder.resolve().name if below == Path() else below)
        try:
            again = (
                redraw(folder, protocol, target, options.device)
                if options.redraw
                else rescore(folder, protocol, target)
            )
            names.add(again.protocol.name)
        except (OSError, ValueError) as error:
            problems.append(error)
    print(f"{len(folders) - len(problems)} records under protocol {', '.join(sorted(names)) or protocol.name}: {out}")
    for problem in problems:
        print(f"envgs-bench rescore: {problem}", file=sys.stderr)
    return int(bool(problems) or not folders)


def _masks(options: argparse.Namespace) -> int:
    import torch
    from rich.console import Console
    from rich.progress import Progress

    from .methods.regions import Ball
    from .region_masks import MaskChoice, make_masks

    ball = None
    if options.foreground:
        *center, radius = options.foreground
        ball = Ball(torch.tensor(center), radius)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(f"masks {options.region}", total=None)
        for done, total in make_masks(
            options.run, MaskChoice(options.region, options.beta, ball), options.out, options.device
        ):
            progress.update(task, completed=done, total=total)
    folder = options.out / f"masks_{options.region}"
    print(f"{total} masks: {folder}, made as {folder}.json says")
    return 0


def _ply(run: Path, out: Path) -> int:
    from .ply_export import export_ply

    for path in export_ply(run, out):
        print(path)
    return 0


def _export(overrides: list[str], form: str, out: Path) -> int:
    from .scene_export import export

    return export(overrides, form, out)


def _explained(command: str, work: Callable[[], int]) -> int:
    """The exit status of `work`; 1 with the explanation where its input cannot be used."""
    try:
        return work()
    except (OSError, ValueError) as error:
        print(f"envgs-bench {command}: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
