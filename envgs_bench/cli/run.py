"""`envgs-bench run`: one run, or a sweep of them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

DESCRIPTION = """\
Train, render, score and time methods on data sets; one folder and one record.json a run.

  envgs-bench run method=envgs dataset=toy/chrome_room
  envgs-bench run -m method=2dgs,3dgs,envmap,envgs seed=0,1,2      every combination, one after the other
  envgs-bench run -m experiment=demo                               a prepared sweep
  envgs-bench run dataset=colmap dataset.root=FOLDER steps=3000    a capture of your own
  envgs-bench run dataset=ref_real/sedan data_root=FOLDER          a scene of the paper, below FOLDER
  envgs-bench run method=renders path=FOLDER method.name=other     test views that another program drew
  envgs-bench run method=my_module:MyMethod                        a method of your own, by its import path
  envgs-bench run -m experiment=demo --dry-run                     what would run, and how long that may take

Keys of every run:
  method, dataset     see `envgs-bench list`; their settings are method.settings.<key>=, dataset.<key>=
                      (`envgs-bench list method NAME` lists a method's)
  perturb.kind, perturb.severity      what is wrong on purpose: docs/reference/perturbations.md
  budget.primitives, budget.mb        the most that the model may have at any step: docs/reference/budgets.md
  budget.frame_ms                     the most that a picture may take at the end, on this device
  protocol, seed, steps, device=auto|cpu|cuda|cuda:1
  runs_dir=runs, cache_dir, timing.frames, timing.seconds
  page=FOLDER         tables, charts and pictures of runs_dir, written again whenever a run ends
  timeout_minutes, memory_gb, device_memory_fraction   limits of a run: it ends with status timeout or out_of_memory
  snapshot_minutes=5  how often a training is saved; one that was interrupted goes on from there
  force=true          rerun finished jobs; a result is replaced where the new run ends with status ok
  retry=failed        go on with what ended with another status than ok; retry=timeout, out_of_memory or diverged with
                      what ended so

Hydra's own options work too: -m, --cfg job (show the composed configuration), --config-dir DIR (more methods and
data sets as YAML files), hydra/launcher=joblib (jobs in parallel).

Exit status: 0 all runs ok, 1 some not, 2 wrong arguments, 130 interrupted.
"""

# How arguments begin with which this process starts no run itself: Hydra only shows something, or a launcher runs them.
ELSEWHERE = ("-c", "--cfg", "-i", "--info", "--hydra-help", "--version", "hydra/launcher=", "+hydra/launcher=")


def main(arguments: Sequence[str]) -> int:
    """Run the jobs that `arguments` describe; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench run",
        description=DESCRIPTION,
        usage="envgs-bench run [-m] [KEY=VALUE ...]",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--dry-run", action="store_true", help="list the runs, those that are done, and the hours left")
    options, overrides = parser.parse_known_args(arguments)
    if not any(one.startswith(ELSEWHERE) for one in overrides):
        from envgs_bench.runs.cuda_probe import begin, has_driver

        if "device=cpu" not in overrides and has_driver():
            begin()
        if not options.dry_run:
            from envgs_bench.runs.started_run import starter_here

            starter_here(ahead=True)  # it imports what runs need, while this process reads and checks what they are
    from .application import run

    return run(overrides, dry=options.dry_run)
