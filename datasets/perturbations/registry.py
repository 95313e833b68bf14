"""Which perturbations of a scene there are. Test views stay as they are, but for what describes the scene itself.

Every run imports all of them, so what takes long to import is imported by those that use it.
"""

from __future__ import annotations

from envgs_bench.core import Scene

from . import background, masks, normals, photographs, points, poses, views
from .perturbation import Perturbation

# Lengths are shares of the scene radius or of the picture's width, so that a level is as severe in any scene.
PERTURBATIONS: dict[str, Perturbation[Scene]] = {
    "exposure": Perturbation(
        photographs.expose_differently, (0.15, 0.5, 1.5), "exposures that deviate by {:g} stops from view to view"
    ),
    "white_balance": Perturbation(
        photographs.balance_differently, (0.05, 0.15, 0.45), "red and blue that deviate by {:.0%} from view to view"
    ),
    "blur": Perturbation(photographs.blur, (0.003, 0.006, 0.012), "blur with a σ of {:.1%} of the width"),
    "noise": Perturbation(photographs.add_noise, (0.02, 0.05, 0.15), "noise with a σ of {:g} of the range"),
    "jpeg": Perturbation(photographs.compress, (50, 20, 5), "JPEG of quality {:g}"),
    "views": Perturbation(views.thin_out, (24, 12, 6, 3), "{:g} training views"),
    "pose_rotation": Perturbation(poses.turn, (0.1, 0.5, 2.0), "cameras turned by {:g}° on average"),
    "pose_translation": Perturbation(poses.shift, (0.001, 0.005, 0.02), "cameras shifted by {:.1%} of the radius"),
    "points_fewer": Perturbation(points.thin_out, (1 / 2, 1 / 8, 1 / 32), "{:.3g} of the points"),
    "points_noisy": Perturbation(points.scatter, (0.005, 0.02, 0.08), "points off by a σ of {:.1%} of the radius"),
    "points_at_cameras": Perturbation(points.move_to_cameras, (0.5, 0.9, 1.0), "{:.0%} of the points at the cameras"),
    "points_near_cameras": Perturbation(
        points.keep_nearest, (1 / 2, 1 / 8, 1 / 32), "only the {:.3g} of the points that are nearest to the cameras"
    ),
    "points_far_fewer": Perturbation(
        points.thin_out_far, (1 / 2, 1 / 8, 0.0), "{:.3g} of the points that are far from all cameras"
    ),
    "points_random": Perturbation(points.randomize, (1.0, 2.0, 4.0), "random points in {:g} × the points' box"),
    "normals_turned": Perturbation(normals.turn, (5.0, 15.0, 30.0), "normals off by {:g}° more on average"),
    "normals_absent": Perturbation(normals.remove, (0.5, 0.9, 1.0), "no normals for {:.0%} of the training views"),
    "normals_mirrored": Perturbation(normals.mirror, (0.25, 0.5, 1.0), "mirrored normals in {:.0%} of the views"),
    "background": Perturbation(background.replace_background, (0.0, 0.5, 1.0), "a background of gray {:g}"),
    "masks_grown": Perturbation(masks.grow, (1, 2, 4), "masks grown by {:g} pixels"),
    "masks_shrunk": Perturbation(masks.shrink, (1, 2, 4), "masks shrunk by {:g} pixels"),
}
