"""What methods, metrics and the parts of models and pictures are called, wherever they are stored, counted or shown."""

from dataclasses import dataclass
from typing import Literal

BASE = "base"  # the set that a camera sees; the layer of its color alone
ENV = "env"  # the set, or the cube map, that only reflected rays meet
SETS = (BASE, ENV)  # the keys of every method's `primitives` and `model_bytes`

REFLECTION = "reflection"  # the layer of the reflected color
BETA = "beta"  # the layer of the blending weight β
ALPHA = "alpha"  # how much of a pixel's light the base set stops
LAYERS = (BASE, REFLECTION, BETA)  # in the order of reports; a method without reflections draws none of them

REFLECTIVE = "reflective"  # the region of what reflects, where a data set knows it
TRANSMISSIVE = "transmissive"  # and of what light passes through

MONO = "mono"  # the loss against the views' own normals
PERCEPTUAL = "perceptual"  # the loss between VGG-16's features
GIVEN = {  # what a method may use of the data besides photographs, poses and points, as reports say it
    "normals": "normals",
    "masks": "masks of mirrors and glass",
    "ball": "a ball that may reflect",
}
LOSSES = {MONO: "L_mono", PERCEPTUAL: "L_perc"}  # what cannot be had everywhere, as the paper writes it (Eq. 11)

# What takes torch to import where it is used: for whoever lists or asks for it without.
PROTOCOL_NAMES = ("envgs", "strict", "inria", "nerfbaselines", "color_corrected", "dists")
LAYOUT_NAMES = ("ply", "compact", "spz", "sog", "compressed-ply", "ply-two-scales")
OLDEST_GPU = (8, 0)  # the compute capability that the cuda backend needs at least: warp-wide integer reductions


@dataclass(frozen=True)
class MethodCard:
    """What a method says of itself to whoever shows its results; records carry it.

    Attributes:
        family: methods of one family share a color.
        label: the name that is printed, as its authors write it; "" where the run's own name is.
        order: its place in tables, ascending.
        color: the family's, "#RRGGBB".
        reflects: whether reflections are modeled, and are not mere color that depends on direction.
        variant_of: the method of which it leaves out or replaces a part; "" where it is a whole one.
        ladder: the ablation ladder that it is on: methods of which each has a part more than the one before.
        step: its place there, from the baseline up.
        adds: the part that it adds to the step before; "" of the baseline.
        published: its name in the paper's tables; "" where those do not have it.
    """

    family: str
    label: str
    order: int
    color: str
    reflects: bool = True
    variant_of: str = ""
    ladder: str = ""
    step: int = 0
    adds: str = ""
    published: str = ""


@dataclass(frozen=True)
class MetricCard:
    """What a metric says of itself to whoever shows its values; records carry it.

    Attributes:
        title: what is printed above its column.
        places: the decimals that are printed, and compared when ranking.
        better: the direction in which a method improves.
        unit: "" where its values have none.
        explanation: a few words on what it measures.
        corrected: whether it is taken of color-corrected pictures, beside the plain metric of this title.
    """

    title: str
    places: Literal[0, 1, 2, 3, 4, 5, 6]
    better: Literal["higher", "lower"]
    unit: str = ""
    explanation: str = ""
    corrected: bool = False
