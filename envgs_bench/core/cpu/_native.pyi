"""What each of the extension's modules offers, see native.py: N primitives, P pixels or R rays, all CPU tensors."""

from torch import Tensor

pixel_lanes: int  # pixels of a row that the rasterizer takes at once

def sleep_while_waiting() -> None: ...  # from now on OpenMP threads that wait for others sleep, torch's too

class RasterPass:
    def forward(
        self,
        planes: tuple[Tensor, ...],  # filled: color [3, P], alpha [P], depth [P], normal [3, P], extras [E, P]
        hits: Tensor,  # [P] int32, filled: primitives blended in each pixel
        weights: Tensor,  # [N] filled: sums of the blending weights
    ) -> None: ...
    def backward(
        self,
        planes: tuple[Tensor, ...],  # as forward() filled them
        gradients: tuple[Tensor | None, ...],  # dL/d(planes), None for zero
        result: tuple[Tensor, ...],  # zeros, filled: dL/d(each field of the set), position gradients [N, 3]
        removals: bool,  # Σ over hits of (α·dL/dα)² in place of dL/dopacity
    ) -> None: ...
    def list_lengths(self) -> list[int]: ...  # [tiles] primitives in each tile's list, as forward() drew them

def raster_pass(
    gaussians: tuple[Tensor, ...],  # the fields of SetTensors
    world_to_camera: Tensor,  # [4, 4] rigid
    intrinsics: Tensor,  # [3, 3] pixels
    pixel_to_direction: Tensor,  # [3, 3] (x, y, 1) to a world direction with camera z = 1
    center: Tensor,  # [3] world units
    width: int,  # pixels
    height: int,  # pixels
    near: float,  # nearest camera-frame depth that is drawn, world units
    low_pass: bool,  # whether to anti-alias
    low_pass_statistics: bool,  # whether position gradients count what the low-pass of a surfel answers
    background: Tensor,  # [3] in [0, 1]
    transmittance_min: float,  # a pixel is finished below this
    threads: int,  # workers; results depend on their number
    /,
) -> RasterPass: ...

class Bvh:
    def __init__(
        self,
        gaussians: tuple[Tensor, ...],  # the fields of SetTensors, of surfels
        threads: int,  # workers that build it
        /,
    ) -> None: ...

class TracePass:
    def __init__(
        self,
        bvh: Bvh,  # over `gaussians`
        gaussians: tuple[Tensor, ...],  # the fields of SetTensors, of surfels
        origins: Tensor,  # [R, 3] world units
        directions: Tensor,  # [R, 3] world frame, any length; zero hits nothing
        transmittance_min: Tensor,  # [R] a ray ends with the hit that takes it below this
        background: Tensor,  # [3] in [0, 1]
        t_min: float,  # hits at smaller t are not drawn, units of |direction|
        sh_along_ray: bool,  # SH at the ray's direction; else from its origin toward each surfel's center
        threads: int,  # workers; sums over rays depend on their number
        /,
    ) -> None: ...
    def forward(
        self,
        planes: tuple[Tensor, ...],  # filled, as RasterPass's, P = R
        hits: Tensor,  # [R] int32, filled: surfels blended along each ray
        weights: Tensor,  # [N] filled: sums of the blending weights
        keep_hits: bool,  # remember hits for backward()
    ) -> None: ...
    def backward(
        self,
        planes: tuple[Tensor, ...],  # as forward() filled them
        gradients: tuple[Tensor | None, ...],  # dL/d(planes), None for zero
        result: tuple[Tensor, ...],  # zeros, filled: dL/d(each field of the set), position gradients [N, 3]
        origins: Tensor,  # [R, 3] filled: dL/dorigins
        directions: Tensor,  # [R, 3] filled: dL/ddirections
        removals: bool,  # Σ over hits of (α·dL/dα)² in place of dL/dopacity
    ) -> None: ...
