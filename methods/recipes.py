"""Recipes: the rules by which published programs train, and ours.

A setting is a number that anybody may want to change. A rule is what tells one program from another, and matters where
two of them are compared: a method names a recipe, and its setting `rules` overrides single ones.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from .validation import Amount, Count, Factor, Length, Power, Share, Steps, checked

REFERENCE_STEPS = 30_000  # what 3DGS, 2DGS and EnvGS are tuned for

RecipeName = Literal[
    "ours",
    "2dgs",
    "3dgs",
    "paper",
    "released",
    "3dgs_dr",
    "gaussian_shader",
    "ref_gaussian",
    "ref_gs",
    "ref_dgs",
    "rt_splatting",
]


@dataclass(frozen=True)
class Rules:
    """The rules of one recipe; the defaults are ours. Steps are of a run of `reference_steps` (see `Schedule`)."""

    reference_steps: Count = REFERENCE_STEPS  # length of the run that the steps of settings and rules are those of
    stretches: bool = True  # a run of more steps than that stretches the schedule; false: it goes on after its end
    longest_run: Steps = 0  # a run that is given more steps ends after so many; 0: every run is as long as it is given
    average_from: Steps = 27_600  # step after which all that is trained is averaged; a run ends with that; 0: never

    sh_every: Steps = 0  # steps after which another SH degree is added; 0: all at once
    sh_from: Steps = 0  # step up to which the base set's color is the same from everywhere, SH degree 0
    position_radius: Length = 0.0  # that the positions' rate grows with, world units; 0: the scene's
    initial_orientation: Literal["surface", "random", "positive", "world"] = "surface"  # of the base set, as of Start
    initial_scale: Factor = 1.0  # of the base set's primitives, × the distance to their neighbors
    growth: Literal["guided", "mcmc", "gradient"] = "guided"  # the base set's; the first two to its size limit
    mean_gradient_over: Literal["drawn", "in_view"] = "drawn"  # steps that drew it, or had it in view, hidden or not
    mean_gradient_of: Literal["all", "own", "color"] = "all"  # own: not of what anti-aliasing draws; color: its alone
    max_growth: Amount = 0.1  # most that either way of growing adds to a set at once, × its size; 0: no limit
    min_views: Amount = 3.0  # primitives that fewer steps since the last densification show are not cloned or split
    oversized: Literal["split", "prune"] = "split"  # above a tenth of the radius: in five, or from the first reset on
    parts_weigh: Literal["share", "most"] = "share"  # a new primitive's weight, of its parent's; most: no new one goes
    reset_on_white: bool = False  # over a white background, opacities are also reset as growth begins

    normal_reference: Literal["unit", "alpha"] = "unit"  # depth map's normals in L_norm; alpha: × the pixel's alpha
    normal_rendered: Literal["unit", "blended"] = "unit"  # in L_norm; blended: as they are, which pulls at alpha too
    normal_side: Literal["camera", "own"] = "camera"  # a surfel's normal is turned to the camera; own: blended as it is
    normal_drawn: Literal["alone", "as_color"] = "alone"  # L_norm's; as_color: n/2 + 1/2 and depth, over the background
    shortest_axis: Literal["column", "row"] = "column"  # of a rotation matrix; row: its first, sorted as the scales are
    normals: Literal["agreed", "as_given"] = "agreed"  # the views' own in L_mono; agreed: turned to agree, and weighed
    mono_loss: Literal["cos", "l1_cos"] = "l1_cos"  # 1 − cos, or the L1 distance beside it
    mono_rendered: Literal["blended", "unit"] = "blended"  # rendered normals in L_mono: as they are, or normalized
    mono_from: Steps = 0  # step after which L_mono counts
    mono_floor: Share = 0.1  # share of mono_weight where nothing reflects; all of it counts from β = initial_beta on
    normal_weighting: Literal["none", "depth", "alpha", "eroded", "mirror"] = "none"  # of pixels, in both normal losses
    perceptual_loss: Literal["features", "lpips"] = "features"  # L_perc: the L1 distance of VGG-16's features, or LPIPS
    perceptual_from: Steps = 0  # step after which L_perc counts

    joint_from: Amount = 1.0  # × initial_beta: where β is below, reflected rays do not move the surface; 0: everywhere
    settling_interval: Count = 5  # × densify_every between warm_up and disturb_until; less in a short run
    beta_threshold: Share = 1 / 255  # what moves a pixel less is not traced: rays of an image, what others leave
    ray_offset: Amount = 1e-3  # a reflected ray starts this far above the surface, × scene radius
    reflect_alpha: Share = 0.0  # pixels whose alpha is not above do not reflect: in images, and late in training
    reflect_alpha_from: Steps = 0  # step after which that holds in training too
    beta_starts_anew: bool = False  # Adam counts β's steps from the first reflection on, not from the run's start
    beta_reset_from: Steps = 0  # step from which opacity resets also reset β; 0: never
    beta_reset: Literal["lower", "raise"] = "lower"  # that bounds β by its start from above, or from below
    shown_first: Literal["albedo", "sh"] = "albedo"  # up to warm_up; sh: SH alone, and then dark albedos that mirror
    mirror_alpha: Literal["learned", "given"] = "learned"  # given: no gradient where it weighs, materials not ÷ by it
    plain_again: bool = False  # what does not mirror is compared with the views by itself, too
    plain_share: Literal["alpha", "rest"] = "alpha"  # weight of what does not mirror; rest: 1 − what mirrors has
    opacity_entropy: Amount = 0.0  # weight of the mean entropy of opacities in view, once anything mirrors
    occupancy_of: Literal["all", "in_view"] = "all"  # surfels whose mean occupancy is minimized
    glass_alike: Amount = 0.0  # weight of what tells a view's transparent pixels apart: Σ (τ − mean)², and of colors
    hidden_layers: Count = 2  # of the network that makes light of features
    map_start: Literal["gray", "random"] = "gray"  # texels of a cube map, at first
    map_texels: Literal["logits", "colors"] = "logits"  # what a cube map's texels learn; colors are cut to [0, 1]

    traced_sh_direction: Literal["center", "ray"] = "center"  # along which a color is seen: to its center, or the ray
    traced_near: Length = 0.0  # hits nearer to a reflected ray's start are not drawn, world units
    traced_background: Literal["scene", "black", "map"] = "scene"  # what reflected rays see behind all; map: a cube map
    env_box: Literal["central", "inside"] = "central"  # 99.5 % of each axis, or of points within 0.5 to 99.5 % of all
    env_gradient: Literal["hit", "camera"] = "hit"  # its gradients count × the way to each hit, or to the camera
    env_from_points: bool = True  # environment primitives start at the scene's points too
    env_initial_opacity: Share = 0.05  # opacity that these start with
    env_sh_from: Steps = 0  # step up to which the environment's color is the same from everywhere, SH degree 0
    env_position_scale: Amount = 5.0  # its position rate, × the base set's
    env_radius_power: Power = 1  # that rate grows with this power of the scene radius


PUBLISHED: dict[str, Any] = {  # the adaptive control of 3DGS, its colors and its length
    "average_from": 0,
    "growth": "gradient",
    "mean_gradient_over": "in_view",
    "mean_gradient_of": "own",
    "max_growth": 0.0,
    "min_views": 0.0,
    "normals": "as_given",
    "mono_loss": "cos",
    "joint_from": 0.0,
    "beta_threshold": 0.0,
}
OF_3DGS: dict[str, Any] = PUBLISHED | {
    "longest_run": 30_000,
    "sh_every": 1_000,
    "initial_orientation": "world",
    "oversized": "prune",
    "reset_on_white": True,
}
OF_2DGS: dict[str, Any] = OF_3DGS | {
    "initial_orientation": "positive",
    "normal_reference": "alpha",
    "normal_rendered": "blended",
}
OF_PAPER: dict[str, Any] = PUBLISHED | {
    "stretches": False,  # as the released code: longer runs are the reference run and more
    "initial_orientation": "positive",  # Sec. 3: 2DGS
    "normal_rendered": "blended",  # Eq. 7
    "parts_weigh": "most",  # not printed
    "mono_floor": 1.0,
    "settling_interval": 1,
    "ray_offset": 0.0,  # Sec. 4.1: from the surface itself
    "traced_sh_direction": "ray",  # not printed
    "env_box": "inside",  # Sec. 4.3, as the released code reads it
    "env_from_points": False,  # Sec. 4.3
    "env_initial_opacity": 0.1,  # as in 2DGS
    "env_position_scale": 1.0,
}
OF_REF_GS: dict[str, Any] = OF_2DGS | {
    "stretches": False,
    "longest_run": 31_000,
    "initial_scale": 0.1**0.5,
    "normal_rendered": "unit",
    "shown_first": "sh",
    "mirror_alpha": "given",
    "plain_again": True,
    "opacity_entropy": 1e-3,
}
RECIPES: dict[RecipeName, Rules] = {
    "ours": Rules(),
    "2dgs": Rules(**OF_2DGS),  # its released code
    "3dgs": Rules(**OF_3DGS),  # its released code
    "paper": Rules(**OF_PAPER),  # EnvGS as printed; where it says nothing, as its released code does
    "released": Rules(  # EnvGS's released code, where that leaves the paper
        **OF_PAPER
        | {
            "sh_every": 1_000,
            "normal_reference": "alpha",
            "mono_loss": "l1_cos",
            "mono_rendered": "unit",
            "normal_weighting": "depth",
            "perceptual_loss": "lpips",
            "perceptual_from": 21_000,
            "settling_interval": 5,
            "beta_reset_from": 6_000,
            "traced_near": 0.06,
            "traced_background": "black",
            "env_gradient": "camera",
            "env_sh_from": 3_000,
            "env_radius_power": 2,
        }
    ),
    "3dgs_dr": Rules(  # 3DGS-DR's released code
        **OF_3DGS
        | {"stretches": False, "longest_run": 61_000, "sh_from": 10_000, "beta_reset_from": 1, "beta_reset": "raise"}
        | {"beta_starts_anew": True}
        | {"mean_gradient_of": "color", "map_start": "random"}
    ),
    "gaussian_shader": Rules(  # GaussianShader's released code
        **OF_3DGS
        | {"position_radius": 5.0, "map_texels": "colors"}
        | {"normal_reference": "alpha", "normal_rendered": "blended", "normal_weighting": "eroded"}
        | {"normal_drawn": "as_color", "shortest_axis": "row"}
    ),
    "ref_gaussian": Rules(  # Ref-Gaussian's released code
        **OF_2DGS
        | {"stretches": False, "longest_run": 50_000, "sh_from": 5_000, "beta_reset_from": 1, "beta_reset": "raise"}
        | {"beta_starts_anew": True}
    ),
    "ref_gs": Rules(**OF_REF_GS),  # its released code, as it trains on captures
    "ref_dgs": Rules(  # as Ref-GS
        **OF_REF_GS | {"reference_steps": 25_000, "longest_run": 25_000} | {"plain_share": "rest", "hidden_layers": 3}
    ),
    "rt_splatting": Rules(  # RT-Splatting's released code
        **OF_2DGS
        | {"stretches": False, "longest_run": 61_000, "perceptual_loss": "lpips", "perceptual_from": 15_000}
        | {"initial_scale": 0.1**0.5, "reset_on_white": False, "normal_rendered": "unit", "normal_weighting": "mirror"}
        | {"normal_side": "own", "occupancy_of": "in_view", "glass_alike": 2e-6}
    ),
}


def rules_of(recipe: RecipeName, overrides: Mapping[str, Any]) -> Rules:
    """The rules of a recipe, but for those that `overrides` gives.

    Raises:
        ValueError: there is no such recipe or rule, or it has another value than is allowed; the message names it.
    """
    if recipe not in RECIPES:
        raise ValueError(f"recipe is {recipe!r}, expected one of {', '.join(RECIPES)}")
    return dataclasses.replace(RECIPES[recipe], **checked(Rules, overrides, "rules."))
