"""How often diagnosis is wrong: its warnings and repairs of scenes in order, and of the same spoiled on purpose."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, get_args

import pandas as pd
import torch
from scipy.stats import binomtest

from envgs_bench.core import Scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.repair import REPAIRS, repaired
from envgs_bench.diagnosis.scene_warnings import scene_warnings
from envgs_bench.records import RepairKind, WarningKind

KINDS = get_args(WarningKind)
OF_SCENES = KINDS[KINDS.index("views_sparse") :]  # the warnings of a scene that is trained on for long enough
PLENTY = 10**6  # steps, so that no scene's training is too short
# what is spoiled, how severely, and which repair, if there is one, and which warning should say so
SPOILED: tuple[tuple[str, int, RepairKind | None, str], ...] = (
    ("exposure", 2, "exposures", "exposures_differ"),
    ("pose_rotation", 3, None, "poses_off"),
    ("normals_mirrored", 2, "normals", "normals_mirrored"),
)


def counted(scene: Scene, seed: int, device: torch.device | str = "cpu") -> list[dict[str, Any]]:
    """One row a question asked of the scene: `asked` of it, `found` or not, with what was measured and `said`.

    Rows of `spoiled` "" are of the scene in order: what is found there is a false alarm. A repair of mirrored normals
    counts as found where it names just the views that were mirrored.
    """
    about = {"scene": scene.name, "seed": seed}
    diagnosis = Diagnosis(scene, device)
    _, outcomes = repaired(diagnosis, list(REPAIRS))
    warned = {warning.kind for warning in scene_warnings(diagnosis, PLENTY)}
    measured = _measured(diagnosis)
    in_order = {**about, "spoiled": "", "severity": 0, **measured}
    rows = [{**in_order, "asked": f"repair {one.kind}", "found": one.kept, "said": one.message} for one in outcomes]
    rows.append({**in_order, "asked": "any warning", "found": bool(warned), "said": " ".join(sorted(warned))})
    rows += [{**in_order, "asked": f"warning {kind}", "found": kind in warned, "said": ""} for kind in OF_SCENES]
    for kind, severity, repair, warning in SPOILED:
        changed = PERTURBATIONS[kind].applied(scene, severity, kind, seed)
        spoiled = Diagnosis(changed, device)
        said = {one.kind for one in scene_warnings(spoiled, PLENTY)}
        own = {**about, "spoiled": kind, "severity": severity, **_measured(spoiled)}
        for outcome in repaired(spoiled, [repair] if repair else [])[1]:
            right = outcome.kept
            if kind == "normals_mirrored":
                turned = {a.name for a, b in zip(scene.train, changed.train, strict=True) if a is not b}
                right = set(spoiled.mirrored) == turned
            rows.append({**own, "asked": f"repair {outcome.kind}", "found": right, "said": outcome.message})
        rows.append({**own, "asked": f"warning {warning}", "found": warning in said, "said": ""})
    return rows


def _measured(diagnosis: Diagnosis) -> dict[str, float]:
    """What the thresholds are compared with."""
    return {
        "stops": round(diagnosis.exposures.stops, 4),
        "pose_gain": round(diagnosis.alignment.gain, 4),
        "photo_consistency": round(diagnosis.photo_consistency, 4),
        "coverage": round(diagnosis.coverage, 4),
        "normal_disagreement": round(diagnosis.disagreement, 3),
        "noise": round(diagnosis.photographs.noise, 4),
        "detail": round(diagnosis.photographs.detail, 5),
        "blockiness": round(diagnosis.photographs.blockiness, 4),
    }


def rates(rows: Iterable[Mapping[Any, Any]]) -> pd.DataFrame:
    """A row a question: of how many scenes it was asked, of how many it found, the share and its 95 % interval.

    The interval is Clopper and Pearson's. Of scenes in order the share is of false alarms, of spoiled ones recall.
    """
    table = pd.DataFrame(list(rows))
    found = []
    for (spoiled, severity, asked), group in table.groupby(["spoiled", "severity", "asked"], sort=True):
        hits, scenes = int(group["found"].sum()), len(group)
        interval = binomtest(hits, scenes).proportion_ci(0.95)
        share = {"found": hits, "scenes": scenes, "share": hits / scenes, "low": interval.low, "high": interval.high}
        found.append({"spoiled": spoiled, "severity": severity, "asked": asked, **share})
    return pd.DataFrame(found)
