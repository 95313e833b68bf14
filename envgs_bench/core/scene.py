"""Scene and View: what a data source hands to a method. Plain containers, on the CPU until a method moves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from .camera import Camera
from .normal_prior import NormalPrior
from .placement import Placement


@dataclass(frozen=True)
class View:
    """One posed photograph and what is known about it."""

    name: str
    """Unique within the scene: the image's stem."""
    camera: Camera
    image: Tensor
    """[H, W, 3] uint8, sRGB."""
    masks: dict[str, Tensor] = field(default_factory=dict)
    """Region name -> [H, W] bool, True inside."""
    normal: Tensor | None = None
    """[H, W, 3] unit, world frame, facing the camera; 0 where unknown. A training view's may be an estimate to learn
    from; a test view's is what scores refer to."""
    depth: Tensor | None = None
    """[H, W] camera-frame z; 0 where unknown."""

    def rgb(self, device: torch.device | str = "cpu") -> Tensor:
        """The image as [H, W, 3] float32 in [0, 1], sRGB."""
        return self.image.to(device) / 255

    def pixels_on(self, device: torch.device | str) -> View:
        """The view with its image and normals there, all else where it is."""
        normal = None if self.normal is None else self.normal.to(device)
        return replace(self, image=self.image.to(device), normal=normal)


@dataclass(frozen=True)
class Scene:
    """Training and test views of one scene, with the sparse points that structure from motion left.

    Lengths are in world units, and 0 where unknown.
    """

    name: str
    train: list[View]
    test: list[View]
    points: Tensor
    """[P, 3] world frame."""
    point_colors: Tensor
    """[P, 3] in [0, 1], sRGB."""
    background: Tensor = field(default_factory=lambda: torch.zeros(3))
    """[3] in [0, 1], behind everything."""
    val: Sequence[View] = ()
    """Taken out of the training views, to choose settings by."""
    unseen: Mapping[str, Sequence[View]] = field(default_factory=dict)
    """Views of places where nobody stood, by how these lie to the training cameras; scored beside those that test."""
    free_space: float = 0.0
    """Nothing is nearer than this to any camera."""
    bounds: float = 0.0
    """Half the edge of a cube around the world's origin that holds the surroundings."""
    normals: NormalPrior | None = None
    """What the training views' normals are worth, where a method asks for that."""
    attributes: Mapping[str, float] = field(default_factory=dict)
    """What the scene is like, where a source knows that from its truth; reports compare methods by it."""
    placement: Placement = field(default_factory=Placement)
    """Where the world lies in that of the data: all positions and lengths here are the world's."""

    @property
    def radius(self) -> float:
        """1.1 × the largest distance of a training camera from their mean center (3DGS's scene scale), world units."""
        centers = torch.stack([view.camera.center for view in self.train])
        return 1.1 * float((centers - centers.mean(0)).norm(dim=1).max())
