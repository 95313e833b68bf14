"""What is wrong with a scene before anything is trained on it, and would not show in a training that fits what it sees.

A run with too few or bad views, or with points or normals that contradict the pictures, learns the training views and
fails on all others. Its losses know nothing of that; the scene does (`envgs_bench.methods.start`). A run that is too
short for its views, or is told to learn too slowly, looks as sound as any.
"""

from __future__ import annotations

import math

import torch

from envgs_bench.core import Scene
from envgs_bench.methods.start.alignment import alignment
from envgs_bench.methods.start.evidence import Evidence, empty_cells
from envgs_bench.methods.start.exposures import UNEQUAL, exposures
from envgs_bench.methods.start.mending import MISSING, UNSUPPORTED
from envgs_bench.methods.start.photographs import BLOCK, BLOCKY, BLURRED, NOISY, Photographs
from envgs_bench.records import TrainingWarning, WarningKind

SPARSE = 12.0  # degrees between the two nearest views of a point from which views are too few to agree on its depth
DISAGREEING = 18.0  # degrees between two views' normals of a point from which EnvGS lost its lead over 2DGS
PASSES = 4  # times that a training view is learned from, below which EnvGS was behind 2DGS inside reflections
POSES_OFF = 0.075  # share of its differences to the points' colors that the median view loses when it is turned


def scene_warnings(
    scene: Scene, steps: int, quickness: float = 1.0, device: torch.device | str = "cpu"
) -> list[TrainingWarning]:
    """What training views, their poses, points and normals warn of, and few steps for them; each of step 0.

    Args:
        steps: of the training, a view each.
        quickness: learning rates beside the method's own: steps at a third of them count as a third of the steps.
        device: where all pixels are looked at.
    """
    if not len(scene.points):
        return []  # the method refuses them
    evidence = Evidence.of(scene, scene.free_space)
    covered = empty_cells(scene, scene.free_space, device)[1]
    support, parallax = evidence.support(), evidence.parallax()
    # Points that are wrong or missing say nothing of exposures or poses, nor do those without colors.
    in_order = support >= UNSUPPORTED and covered >= MISSING
    aligned, bright = alignment(evidence, device), exposures(evidence)
    mirrored, views = evidence.mirrored_views(), len(scene.train)
    taken = Photographs.of(scene.train)
    disagreement = evidence.normal_disagreement(evidence.normals_unmirrored(mirrored))
    slowly = f", at {quickness:.2g} times the method's own learning rates" if quickness < 1 else ""
    found: list[tuple[WarningKind, bool, str]] = [
        (
            "run_short",
            steps * quickness < PASSES * views,
            f"each of {views} training views is learned from {steps / views:.1f} times{slowly}, which is no length to "
            f"judge a method by: take {math.ceil(PASSES * views / quickness)} steps at least",
        ),
        (
            "views_sparse",
            parallax > SPARSE and support >= UNSUPPORTED,  # else points say nothing of views
            f"a point is usually seen from {parallax:.0f}° beside in the nearest other of {views} training views: "
            "what is not seen from there may be wrong in test views",
        ),
        (
            "views_noisy",
            taken.noise > NOISY,
            f"noise of about {taken.noise:.0%} of the range is in the training views, and a method learns it",
        ),
        (
            "views_blurred",
            taken.detail < BLURRED,
            "the training views show hardly any fine detail: they are blurred, and so will be what is learned",
        ),
        (
            "views_blocky",
            taken.blockiness > BLOCKY,
            f"the training views change {taken.blockiness:.0%} more where blocks of {BLOCK} pixels meet: they were "
            "compressed hard, each in a way of its own",
        ),
        (
            "points_missing",
            covered < MISSING,
            f"points lie in only {covered:.0%} of the parts of a training view that show something",
        ),
        (
            "points_unsupported",
            support < UNSUPPORTED,
            f"the points' colors are only {support:.0%} nearer to what the views show there than other points' are: "
            "the points, or the poses, are not those of the pictures",
        ),
        (
            "exposures_differ",
            bright.deviation > UNEQUAL and in_order,
            "the training views are not equally bright, or not of one tint: the median view is off by "
            f"{bright.stops:.1f} stops in some channel, which a method without a term for it blends",
        ),
        (
            "poses_off",
            aligned.gain > POSES_OFF and in_order and not evidence.colorless,
            f"the training views agree {aligned.gain:.0%} better with the points' colors once they are turned, the "
            f"median view by {aligned.degrees:.1f}°: their poses may be off",
        ),
        (
            "normals_mirrored",
            bool(mirrored),
            f"the normals of {len(mirrored)} of {views} training views agree with the others' only when they are "
            "mirrored from left to right: their axes may follow another convention",
        ),
        (
            "normals_disagree",
            disagreement > DISAGREEING and support >= UNSUPPORTED,  # two views see wrong points at two places
            f"the normals of neighboring training views usually differ by {disagreement:.0f}° at the same point: a "
            "method that learns from them may end below one that does not; estimate them in another way",
        ),
    ]
    return [TrainingWarning(kind=kind, step=0, part="", message=text) for kind, wrong, text in found if wrong]
