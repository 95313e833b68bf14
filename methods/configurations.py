"""What configurations of methods say of themselves beyond their classes' cards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from envgs_bench.parts import MethodCard

# Configuration's name -> what of its card differs from its class's. Others stand behind their class, by name.
CONFIGURED: Mapping[str, Mapping[str, Any]] = {
    "3dgs": {"published": "3DGS"},
    "3dgs_tuned": {"order": 11},
    "3dgs_lean": {"order": 12},
    "3dgs_mcmc": {"order": 13},
    "2dgs": {"published": "2DGS"},
    "2dgs_tuned": {"order": 21, "ladder": "envgs", "step": 0},
    "2dgs_lean": {"order": 22},
    "2dgs_mcmc": {"order": 23},
    "envmap_paper": {"order": 29, "variant_of": "envgs_paper", "published": "w/ environment map"},
    "envmap": {"variant_of": "envgs", "ladder": "envgs", "step": 1, "adds": "environment map"},
    "envgs_released": {"order": 37},
    "envgs_paper": {"order": 38, "published": "EnvGS"},
    "envgs_lean": {"order": 39},
    "envgs": {"ladder": "envgs", "step": 3, "adds": "joint optimization"},
    "envgs_no_joint": {
        "order": 42,
        "variant_of": "envgs",
        "ladder": "envgs",
        "step": 2,
        "adds": "environment Gaussians",
    },
    "envgs_paper_no_joint": {"order": 43, "variant_of": "envgs_paper", "published": "w/o joint optimization"},
    "envgs_paper_no_mono_normal": {"order": 44, "variant_of": "envgs_paper", "published": "w/o mono normal loss"},
    "envgs_paper_no_color_sabotage": {"order": 45, "variant_of": "envgs_paper", "published": "w/o color sabotage"},
    "envgs_paper_no_normal_propagation": {
        "order": 46,
        "variant_of": "envgs_paper",
        "published": "w/o normal propagation",
    },
    "envgs_paper_no_perceptual": {"order": 47, "variant_of": "envgs_paper", "published": "w/o lpips loss"},
    "envgs_paper_single_set": {"order": 48, "variant_of": "envgs_paper"},
    "envgs_planes": {"order": 49, "label": "EnvGS, planes"},
    "envgs_far_map": {"order": 41, "label": "EnvGS, far map"},
    "envgs_single_set": {"variant_of": "envgs"},
    "ref_gs": {"published": "Ref-GS"},
    "ref_gs_tuned": {"order": 101},
    "ref_dgs": {"label": "Ref-DGS", "order": 102},
    "ref_dgs_tuned": {"label": "Ref-DGS", "order": 103},
    "rt_splatting_tuned": {"order": 105},
    "3dgs_dr": {"published": "3DGS-DR"},
    "3igs": {"published": "3iGS"},
    "gaussian_shader": {"published": "GaussianShader"},
}


def configured(name: str, card: MethodCard) -> MethodCard:
    """The card of the configuration `name` of the class whose card this is."""
    return replace(card, **CONFIGURED.get(name, {}))
