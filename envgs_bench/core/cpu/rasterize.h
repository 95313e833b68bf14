// Tile rasterizer for surfels and 3D Gaussians.
#pragma once
#include <memory>
#include <vector>

#include "gaussians.h"

namespace envgs {

// One image. What the forward pass prepares is kept for the backward pass. The arrays of `gaussians` must outlive it.
class RasterPass {
public:
    virtual ~RasterPass() = default;
    virtual void forward(Planes<float> out,  // filled, P = H·W
                         int* hits,          // [H·W] filled: primitives blended in each pixel
                         float* weights      // [N] filled: sums of the blending weights
                         ) = 0;
    virtual void backward(Planes<const float> out,       // as forward() filled them
                          Planes<const float> gradient,  // dL/d(out)
                          GaussianGradients result,      // filled
                          bool removals                  // Σ removal_square of each primitive, for dL/dopacity
                          ) = 0;
    // Primitives in the list of each tile, row by row of tiles, as forward() drew them.
    virtual std::vector<int> list_lengths() const = 0;
};

std::unique_ptr<RasterPass> make_raster_pass(const Gaussians& gaussians,
                                             bool surfels,  // surfels, or else 3D Gaussians
                                             const PinholeCamera& camera,
                                             Vec3<float> background,   // in [0, 1]
                                             float transmittance_min,  // a pixel is finished below this
                                             int threads               // workers; results depend on their number
);

}  // namespace envgs
