"""Attributes of scenes in words: what a scene is like where a value is below a bound, or is not."""

from __future__ import annotations

SHARES = {
    "reflective": "of the pixels reflect",
    "mirror": "of the pixels mirror",
    "rough": "of the pixels reflect roughly",
    "coated": "of the pixels are coated",
    "transmissive": "of the pixels are glass",
    "near_field": "of the reflections are of near things",
    "self_field": "of the reflections are of the same thing",
    "far_field": "of the reflections are of the sky",
    "points_missing": "of the textured cells lack points",
    "clipped": "of the pixels are white",
    "sky": "of the pixels are sky",
}
AMOUNTS = {  # below, not below, unit
    "roughness": ("reflections are sharper than roughness", "reflections have roughness of at least", ""),
    "curvature": ("what reflects is flatter than", "what reflects is curved by at least", "/m"),
    "mirrored_distance": ("what is mirrored is nearer than", "what is mirrored is as far as", "m"),
    "texture": ("texture is below", "texture is at least", ""),
    "views": ("views are fewer than", "views are at least", ""),
    "view_angle": ("views are closer than", "views are apart by at least", "°"),
    "points": ("points are fewer than", "points are at least", ""),
    "brightness_range": ("brightness spans less than", "brightness spans at least", "stops"),
    "normals_off": ("normals are off by less than", "normals are off by at least", "°"),
}


def condition(attribute: str, value: float, below: bool) -> str:
    """As `less than 2 % of the pixels mirror`; an attribute without words of its own is named."""
    if attribute in SHARES:
        return f"{'less than' if below else 'at least'} {100 * value:.2g} % {SHARES[attribute]}"
    under, over, unit = AMOUNTS.get(
        attribute, (f"{attribute.replace('_', ' ')} is below", f"{attribute.replace('_', ' ')} is at least", "")
    )
    space = "" if unit in ("", "°", "/m") else " "
    return f"{under if below else over} {value:.3g}{space}{unit}"
