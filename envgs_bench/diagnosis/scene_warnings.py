"""Warnings of a scene before anything is trained on it: what would not show in a training that fits what it sees.

A run with too few or bad views, or with points or normals that contradict the pictures, learns the training views and
fails on all others. Its losses know nothing of that; the scene does. A run that is too short for its views, or is told
to learn too slowly, looks as sound as any.
"""

from __future__ import annotations

import math

from envgs_bench.records import TrainingWarning, WarningKind

from .diagnosis import Diagnosis
from .photographs import BLOCK
from .thresholds import (
    BLOCKY,
    BLURRED,
    DISAGREEING,
    HIDDEN,
    MISSING,
    NOISY,
    PASSES,
    POSES_OFF,
    SPARSE,
    TELLING,
    UNSUPPORTED,
)


def scene_warnings(
    diagnosis: Diagnosis, steps: int, quickness: float = 1.0, near: float = 0.0
) -> list[TrainingWarning]:
    """What training views, their poses, points and normals warn of, and few steps for them; each of step 0.

    Args:
        diagnosis: of a scene with points; methods refuse others.
        steps: of the training, a view each.
        quickness: learning rates beside the method's own: steps at a third of them count as a third of the steps.
        near: what is nearer to a camera is not drawn, world units.
    """
    views, taken = len(diagnosis.scene.train), diagnosis.photographs
    support, covered = diagnosis.photo_consistency, diagnosis.coverage
    parallax, in_order = diagnosis.parallax, diagnosis.points_in_order
    aligned, bright = diagnosis.alignment, diagnosis.exposures
    mirrored, disagreement = diagnosis.mirrored.views, diagnosis.disagreement
    hidden = diagnosis.observations.hidden_share(near)
    slowly = f", at {quickness:.2g} times the method's own learning rates" if quickness < 1 else ""
    found: list[tuple[WarningKind, bool, str]] = [
        (
            "run_short",
            steps * quickness < PASSES * views,
            f"each of {views} training views is learned from {steps / views:.1f} times{slowly}, which is no length to "
            f"judge a method by: take {math.ceil(PASSES * views / quickness)} steps at least",
        ),
        (
            "near_hides",
            hidden > HIDDEN,
            f"{hidden:.0%} of the points in a training view are nearer than {near:g} world units, and nothing is drawn "
            "there: state a smaller dataset.free_space, or give the world larger units",
        ),
        (
            "views_sparse",
            parallax > SPARSE and support >= UNSUPPORTED,  # else points say nothing of views
            f"a point is usually seen from {parallax:.0f}° beside in the nearest other of {views} training views: "
            "what is not seen from there may be wrong in test views; or points lie nearer to the cameras than the rest",
        ),
        (
            "views_noisy",
            taken.noise > NOISY,
            f"noise of about {taken.noise:.0%} of the range is in the training views, and a method learns it; or "
            "all surfaces are as finely grained",
        ),
        (
            "views_blurred",
            taken.detail < BLURRED,
            "the training views show hardly any fine detail: they are blurred, and so will be what is learned; or "
            "the scene has none",
        ),
        (
            "views_blocky",
            taken.blockiness > BLOCKY,
            f"the training views change {taken.blockiness:.0%} more where blocks of {BLOCK} pixels meet: they were "
            "compressed hard, each in a way of its own; or a fine grid is seen head-on",
        ),
        (
            "points_missing",
            covered < MISSING,
            f"points lie in only {covered:.0%} of the parts of a training view that show something; or the rest "
            "mirrors, where structure from motion finds none",
        ),
        (
            "points_unsupported",
            support < UNSUPPORTED,
            f"the points' colors are only {support:.0%} nearer to what the views show there than other points' are: "
            "the points, or the poses, are not those of the pictures; or most of the scene mirrors",
        ),
        (
            "exposures_differ",
            bool(bright.factors) and in_order,
            "the training views are not equally bright, or not of one tint: the median view is off by "
            f"{bright.stops:.1f} stops in some channel, which a method without exposure=affine blends; or the scene "
            "reflects something brighter to some views than to others",
        ),
        (
            "poses_off",
            aligned.gain > POSES_OFF and diagnosis.poses_told,
            f"the training views agree {aligned.gain:.0%} better with the points' colors once they are turned, the "
            f"median view by {aligned.degrees:.1f}°: their poses may be off; or surfaces repeat themselves or reflect",
        ),
        (
            "normals_mirrored",
            bool(mirrored),
            f"the normals of {len(mirrored)} of {views} training views agree with the others' only when they are "
            "mirrored from left to right: their axes may follow another convention; or estimates are hardly better "
            "than chance",
        ),
        (
            "normals_disagree",
            disagreement > DISAGREEING and support >= UNSUPPORTED,  # two views see wrong points at two places
            f"the normals of neighboring training views usually differ by {disagreement:.0f}° at the same point: a "
            "method that learns from them may end below one that does not; estimate them in another way; or the scene "
            "reflects, which estimators take for what is reflected",
        ),
    ]
    return [TrainingWarning(kind=kind, step=0, part="", message=text) for kind, wrong, text in found if wrong]


def scene_notes(diagnosis: Diagnosis) -> list[str]:
    """What is measured of the scene and is no fault by itself: scenes in order that shine have few points too."""
    if MISSING <= diagnosis.coverage < TELLING:
        return [
            f"points lie in {diagnosis.coverage:.0%} of the parts of a training view that show something, too few to "
            "tell by them whether poses and exposures are right"
        ]
    return []
