"""Repairs of a scene, as far as a run asks for them: one outcome a kind, with what was found.

A scene in order is left as it is, to the last bit. Test views are never changed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from envgs_bench.core import Scene, View
from envgs_bench.records import RepairKind, RepairOutcome

from .diagnosis import Diagnosis
from .exposures import equalized
from .mirrored_normals import mirrored_normals
from .poses import turned
from .thresholds import TURNED

Repaired = tuple[Scene, RepairOutcome]


def repaired(diagnosis: Diagnosis, kinds: Sequence[RepairKind]) -> tuple[Diagnosis, list[RepairOutcome]]:
    """The diagnosis of the scene after these repairs, the same object where none was made; and what became of each.

    Exposures come first, which poses are told by, and normals last, since views turn theirs.
    """
    outcomes = []
    for kind in (kind for kind in REPAIRS if kind in kinds):
        scene, outcome = REPAIRS[kind](diagnosis)
        outcomes.append(outcome)
        if scene is not diagnosis.scene:
            diagnosis = Diagnosis(scene, diagnosis.device)
    return diagnosis, outcomes


def _exposures(diagnosis: Diagnosis) -> Repaired:
    if not diagnosis.points_in_order:
        return diagnosis.scene, _unknown("exposures", diagnosis)
    bright = diagnosis.exposures
    found = {"stops": bright.stops}
    if not bright.factors:
        return diagnosis.scene, RepairOutcome(
            kind="exposures", kept=False, message="views are equally bright", measured=found
        )

    def equal(view: View) -> View:
        own = bright.factors.get(view.name)
        return view if own is None else replace(view, image=equalized(view.image, own))

    said = (
        f"{len(bright.factors)} of {len(diagnosis.scene.train)} training views are made equally bright, in each "
        f"channel: what they show at the points is off by {bright.stops:.1f} stops, the median view's"
    )
    outcome = RepairOutcome(kind="exposures", kept=True, message=said, measured=found)
    return _with_views(diagnosis.scene, equal), outcome


def _poses(diagnosis: Diagnosis) -> Repaired:
    if not diagnosis.poses_told:
        return diagnosis.scene, _unknown("poses", diagnosis)
    aligned = diagnosis.alignment
    found = {"gain": aligned.gain, "degrees": aligned.degrees}
    if aligned.gain <= TURNED:
        return diagnosis.scene, RepairOutcome(kind="poses", kept=False, message="poses are in order", measured=found)
    each = zip(diagnosis.scene.train, aligned.turns, aligned.gains, strict=True)
    turns = {view.name: turn for view, turn, gain in each if gain > 0}
    said = (
        f"{len(turns)} of {len(diagnosis.scene.train)} training views are turned to where they show the points, the "
        f"median view by {aligned.degrees:.1f}°"
    )
    scene = _with_views(diagnosis.scene, lambda view: turned(view, turns[view.name]) if view.name in turns else view)
    return scene, RepairOutcome(kind="poses", kept=True, message=said, measured=found)


def _unknown(kind: RepairKind, diagnosis: Diagnosis) -> RepairOutcome:
    said = "the points, which are missing, wrong or of one color, say nothing of that"
    known = {"photo_consistency": diagnosis.photo_consistency, "coverage": diagnosis.coverage}
    return RepairOutcome(kind=kind, kept=False, message=said, measured=known)


def _normals(diagnosis: Diagnosis) -> Repaired:
    scene, mirrored = diagnosis.scene, frozenset(diagnosis.mirrored.views)
    found = {"mirrored_views": float(len(mirrored)), "gain": diagnosis.mirrored.gain}
    if not mirrored:
        return scene, RepairOutcome(kind="normals", kept=False, message="no normals are mirrored", measured=found)

    def unmirrored(view: View) -> View:
        if view.normal is None or view.name not in mirrored:
            return view
        return replace(view, normal=mirrored_normals(view.normal, view))

    said = f"the normals of {len(mirrored)} of {len(scene.train)} training views are mirrored back"
    return _with_views(scene, unmirrored), RepairOutcome(kind="normals", kept=True, message=said, measured=found)


def _with_views(scene: Scene, changed: Callable[[View], View]) -> Scene:
    return replace(scene, train=[changed(view) for view in scene.train])


REPAIRS: dict[RepairKind, Callable[[Diagnosis], Repaired]] = {
    "exposures": _exposures,
    "poses": _poses,
    "normals": _normals,
}
