"""Tables of kept perturbed runs: what they lost, what was warned of, and how early."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from .csv_file import NoRunsError
from .perturbed_file import NONE, UNTRIED
from .tables import NOTHING, as_markdown

LEAST = "1"  # dB from which a run has lost something
REPAIRED_BY = {
    "exposures": "exposures_differ",
    "poses": "poses_off",
    "normals": "normals_mirrored",
}  # and the warning that is given with it
SAME = "="


def with_losses(rows: pd.DataFrame) -> pd.DataFrame:
    """The runs beside their partners, the unperturbed runs as given of the same scene, method, steps and seed.

    `lost` is in dB, infinite where a run did not finish; `warned` and `told` are the kinds that the partner was not
    warned of, before the first step and at all. Left out are runs without a finished partner, and those that say
    nothing of the method.
    """
    keys = ["scene", "method", "steps", "seed"]
    rows = rows.assign(psnr=pd.to_numeric(rows["psnr"]), severity=rows["severity"].astype(int))
    given = (rows["perturbed"] == NONE) & (rows["repair"] == NONE) & (rows["status"] == "ok")
    partners = rows.loc[given, [*keys, "psnr", "before", "during"]]
    paired = rows[~rows["status"].isin(UNTRIED)].merge(partners, on=keys, suffixes=("", "_partner"))
    paired["lost"] = (paired["psnr_partner"] - paired["psnr"]).where(paired["status"] == "ok", math.inf)
    paired["warned"] = [_new(run, ("before",)) for run in paired.to_dict("records")]
    paired["told"] = [_new(run, ("before", "during")) for run in paired.to_dict("records")]
    return paired


def _new(run: Mapping[Any, Any], columns: Iterable[str]) -> bool:
    columns = tuple(columns)
    own, theirs = ({word for name in columns for word in run[name + end].split()} for end in ("", "_partner"))
    return bool(own - theirs)


def recall(rows: pd.DataFrame, name: str, least: str = LEAST) -> str:
    """A row a perturbation: of the runs that lost so many dB, how many were warned of."""
    runs = with_losses(rows)
    runs = runs[(runs["perturbed"] != NONE) & (runs["repair"] == NONE)]
    if runs.empty:
        raise NoRunsError(f"{name} has no perturbed run with a partner")
    lost = runs[runs["lost"] >= float(least)]
    groups = [(f"`{kind}`", group) for kind, group in runs.groupby("perturbed", sort=True)]
    lines = []
    for title, group in [*groups, ("all", runs)]:
        own = lost[lost.index.isin(group.index)]
        before, ever = int(own["warned"].sum()), int(own["told"].sum())
        lines.append(
            [title, str(len(group)), str(len(own)), *((str(n) if len(own) else NOTHING) for n in (before, ever))]
        )
    heads = ["perturbation", "runs", f"lost {least} dB", "warned of before the first step", "… or while training"]
    return f"{as_markdown(heads, lines)}\n{_caption(runs, name)}\n"


def lag(rows: pd.DataFrame, name: str, least: str = LEAST) -> str:
    """A row a perturbation: of the scenes and methods that lost so many dB, whether they were warned of earlier."""
    runs = with_losses(rows)
    runs = runs[(runs["perturbed"] != NONE) & (runs["repair"] == NONE)]
    found: dict[str, list[float]] = {}
    for (kind, *_), ladder in runs.groupby(["perturbed", "scene", "method", "steps", "seed"], sort=True):
        failed = ladder.loc[ladder["lost"] >= float(least), "severity"].min()
        if not math.isnan(failed):
            warned = ladder.loc[ladder["warned"], "severity"].min()
            found.setdefault(f"`{kind}`", []).append(math.inf if math.isnan(warned) else warned - failed)
    if not found:
        raise NoRunsError(f"{name} has no perturbed run that lost {least} dB")
    found["all"] = [lag for lags in found.values() for lag in lags]
    lines = [
        [title, *(str(sum(test(lag) for lag in lags)) for test in (_any, _earlier, _as_early, _later, math.isinf))]
        for title, lags in found.items()
    ]
    heads = ["perturbation", f"lost {least} dB at some severity", "warned earlier", "at the same", "later", "never"]
    return f"{as_markdown(heads, lines)}\n{_caption(runs, name)}\n"


def _any(lag: float) -> bool:
    return True


def _earlier(lag: float) -> bool:
    return lag < 0


def _as_early(lag: float) -> bool:
    return lag == 0


def _later(lag: float) -> bool:
    return 0 < lag < math.inf


def stability(rows: pd.DataFrame, name: str) -> str:
    """A row a perturbation and severity: the change in PSNR from the partner, as given and after each repair.

    A repair that had nothing to change leaves the run as it is, to the last bit: such cells say so.
    """
    runs = with_losses(rows)
    if runs.empty:
        raise NoRunsError(f"{name} has no run with a partner")
    methods = sorted(runs["method"].unique())
    repairs = [NONE, *(each for each in REPAIRED_BY if each in set(runs["repair"]))]
    lines = []
    order = {kind: index for index, kind in enumerate(runs["perturbed"].unique())}
    cases = sorted({(kind, severity) for kind, severity in zip(runs["perturbed"], runs["severity"], strict=True)})
    for kind, severity in sorted(cases, key=lambda case: (case[0] != NONE, case[0], order[case[0]], case[1])):
        own = runs[(runs["perturbed"] == kind) & (runs["severity"] == severity)]
        cells = [_change(own, method, repair) for repair in repairs for method in methods]
        lines.append([f"`{kind}` {severity}" if severity else "unperturbed", *cells])
    heads = [
        "",
        *(f"`{method}`{'' if repair == NONE else f', repair={repair}'}" for repair in repairs for method in methods),
    ]
    return f"{as_markdown(heads, lines)}\n{_caption(runs, name)}\n"


def _change(runs: pd.DataFrame, method: str, repair: str) -> str:
    """Mean over seeds of what changed, and how many runs finished where not all did."""
    own = runs[(runs["method"] == method) & (runs["repair"] == repair)]
    if own.empty:
        given = runs[(runs["method"] == method) & (runs["repair"] == NONE)]
        warned = given["before"].str.split().map(lambda kinds: REPAIRED_BY.get(repair) in kinds)
        return NOTHING if given.empty or warned.any() else SAME
    done = own[own["lost"] < math.inf]
    if done.empty:
        return f"{NOTHING} (0/{len(own)})"
    change = round(-float(done["lost"].mean()), 2)
    text = f"{change:+.2f}".replace("-", "−") if change else "0.00"
    return text if len(done) == len(own) else f"{text} ({len(done)}/{len(own)})"


def _caption(runs: pd.DataFrame, name: str) -> str:
    scenes, seeds = sorted(runs["scene"].unique()), sorted(runs["seed"].unique(), key=int)
    where = f"`{scenes[0]}`" if len(scenes) == 1 else f"{len(scenes)} scenes"
    steps = ", ".join(f"{int(each):,}" for each in sorted(runs["steps"].unique(), key=int))
    devices, commits = (
        ", ".join(sorted(runs["device"].unique())),
        ", ".join(f"`{c}`" for c in sorted(runs["commit"].unique())),
    )
    named = f"seed{'s' * (len(seeds) > 1)} {', '.join(seeds)}"
    return f"*{where}, {steps} steps, {named}; {devices}, commit {commits}. Source: `{name}`.*"
