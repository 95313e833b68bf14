"""Settings that make methods small enough for tests, by kind."""

from __future__ import annotations

from typing import Any

SMALL: dict[str, dict[str, Any]] = {
    "2dgs": {},
    "3dgs": {},
    "envmap": {"envmap_size": 8},
    "envgs": {"env_grid": 2},
    "envgs_single_set": {},
    "3dgs_dr": {"envmap_size": 8},
    "ref_gaussian": {"envmap_size": 8, "shade_until": 9_000, "indirect_from": 15_000},
    "ref_gs": {"map_levels": 3, "near_set": True, "warm_up": 12_000},
    "gaussian_shader": {"envmap_size": 8},
    "3igs": {"field_size": 8},
}
