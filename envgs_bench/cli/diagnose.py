"""`envgs-bench diagnose`: how often warnings and repairs are wrong, counted on scenes and on the same spoiled."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import complain, explained


def main(arguments: Sequence[str]) -> int:
    """Count, scene by scene; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench diagnose",
        usage="envgs-bench diagnose [KEY=VALUE ...] --seeds FIRST-LAST --out FILE",
        description="Count false alarms of warnings and repairs on sampled scenes in order, and how many of the same "
        "scenes they find once these are spoiled. A scene's rows are added to FILE as soon as they are there; scenes "
        "that are in it are not asked again.",
        allow_abbrev=False,
    )
    parser.add_argument("--seeds", metavar="FIRST-LAST", required=True, help="of the sampled scenes, as 1000-1063")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", required=True, help="a CSV, a row a scene, in order or spoiled"
    )
    options, overrides = parser.parse_known_args(arguments)
    first, _, last = options.seeds.partition("-")
    if not (first.isdigit() and (last or first).isdigit() and int(first) <= int(last or first)):
        complain(
            "diagnose", f"--seeds {options.seeds}: expected FIRST-LAST, as 1000-1063", see="reference/sampled_scenes"
        )
        return 2
    seeds = range(int(first), int(last or first) + 1)
    return explained("diagnose", lambda: _diagnose(overrides, seeds, options.out), options.out)


def _diagnose(overrides: list[str], seeds: range, out: Path) -> int:
    import pandas as pd

    from envgs_bench.datasets import load_scene
    from envgs_bench.reports.kept.counts import rates, read_counts
    from envgs_bench.settings import SettingsError

    from .composition import composed
    from .diagnosis_counts import counted

    done = set(read_counts(out)["seed"]) if out.is_file() else set()
    for seed in seeds:
        if seed in done:
            continue
        try:
            settings = composed(["dataset=sampled", *overrides, f"dataset.seed={seed}"])
        except SettingsError as error:
            complain("diagnose", error)
            return 2
        rows = pd.DataFrame(counted(load_scene(settings.dataset, settings.cache_dir), seed))
        rows.to_csv(out, mode="a", header=not out.is_file(), index=False)
    print(pd.DataFrame([vars(rate) for rate in rates(read_counts(out))]).to_string(index=False))
    return 0
