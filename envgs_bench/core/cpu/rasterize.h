// Tile rasterizer for surfels and 3D Gaussians.
#pragma once
#include <memory>

#include "gaussians.h"

namespace envgs {

// One image: what the forward pass prepared is kept for the backward pass. The arrays of `gaussians` must outlive it.
class RasterPass {
public:
    virtual ~RasterPass() = default;
    // Fills the planes [H·W], hits [H·W] and the blending weights [N].
    virtual void forward(Planes<float> out, int* hits, float* weights) = 0;
    virtual void backward(Planes<const float> out, Planes<const float> gradient, GaussianGradients result) = 0;
};

std::unique_ptr<RasterPass> make_raster_pass(const Gaussians& gaussians, bool surfels, const PinholeCamera& camera,
                                             Vec3<float> background, float transmittance_min, int threads);

}  // namespace envgs
