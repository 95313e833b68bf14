"""Which perturbations of a scene there are. Test views stay as they are, but for what describes the scene itself.

Each is imported where it is applied: runs are composed, and kinds are listed, without torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from envgs_bench.import_path import load_import_path

from .perturbation import Perturbation

if TYPE_CHECKING:
    from envgs_bench.core import Scene


def _of(path: str) -> Any:
    """The function that "module:name" names in this folder, imported when it is called."""
    return lambda *given: load_import_path(f"{__package__}.{path}")(*given)


# Lengths are shares of the scene radius or of the picture's width, so that a level is as severe in any scene.
PERTURBATIONS: dict[str, Perturbation[Scene]] = {
    "exposure": Perturbation(
        _of("photographs:expose_differently"),
        (0.15, 0.5, 1.5),
        "exposures that deviate by {:g} stops from view to view",
    ),
    "white_balance": Perturbation(
        _of("photographs:balance_differently"),
        (0.05, 0.15, 0.45),
        "red and blue that deviate by {:.0%} from view to view",
    ),
    "blur": Perturbation(_of("photographs:blur"), (0.003, 0.006, 0.012), "blur with a σ of {:.1%} of the width"),
    "noise": Perturbation(_of("photographs:add_noise"), (0.02, 0.05, 0.15), "noise with a σ of {:g} of the range"),
    "jpeg": Perturbation(_of("photographs:compress"), (50, 20, 5), "JPEG of quality {:g}"),
    "views": Perturbation(_of("views:thin_out"), (24, 12, 6, 3), "{:g} training views"),
    "pose_rotation": Perturbation(
        _of("poses:turn"), (0.1, 0.5, 2.0), "cameras turned by {:g}° on average", moves_cameras=True
    ),
    "pose_translation": Perturbation(
        _of("poses:shift"), (0.001, 0.005, 0.02), "cameras shifted by {:.1%} of the radius", moves_cameras=True
    ),
    "points_fewer": Perturbation(_of("points:thin_out"), (1 / 2, 1 / 8, 1 / 32), "{:.3g} of the points"),
    "points_noisy": Perturbation(
        _of("points:scatter"), (0.005, 0.02, 0.08), "points off by a σ of {:.1%} of the radius"
    ),
    "points_at_cameras": Perturbation(
        _of("points:move_to_cameras"), (0.5, 0.9, 1.0), "{:.0%} of the points at the cameras"
    ),
    "points_near_cameras": Perturbation(
        _of("points:keep_nearest"),
        (1 / 2, 1 / 8, 1 / 32),
        "only the {:.3g} of the points that are nearest to the cameras",
    ),
    "points_far_fewer": Perturbation(
        _of("points:thin_out_far"), (1 / 2, 1 / 8, 0.0), "{:.3g} of the points that are far from all cameras"
    ),
    "points_random": Perturbation(_of("points:randomize"), (1.0, 2.0, 4.0), "random points in {:g} × the points' box"),
    "normals_turned": Perturbation(_of("normals:turn"), (5.0, 15.0, 30.0), "normals off by {:g}° more on average"),
    "normals_absent": Perturbation(
        _of("normals:remove"), (0.5, 0.9, 1.0), "no normals for {:.0%} of the training views"
    ),
    "normals_mirrored": Perturbation(
        _of("normals:mirror"), (0.25, 0.5, 1.0), "mirrored normals in {:.0%} of the views"
    ),
    "background": Perturbation(_of("background:replace_background"), (0.0, 0.5, 1.0), "a background of gray {:g}"),
    "masks_grown": Perturbation(_of("masks:grow"), (1, 2, 4), "masks grown by {:g} pixels"),
    "masks_shrunk": Perturbation(_of("masks:shrink"), (1, 2, 4), "masks shrunk by {:g} pixels"),
}
