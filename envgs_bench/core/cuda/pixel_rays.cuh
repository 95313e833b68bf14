// The rays through an image's pixels, for kernels that take a thread a pixel.
#pragma once
#include "kernels/splat.h"

namespace envgs {

// The direction through the center of a pixel, as `Camera.rays()` has it: camera z = 1.
ENVGS_FN Vec3<float> ray_through(const PinholeCamera& camera, int column, int row) {
    return camera.pixel_to_direction * Vec3<float>{column + 0.5f, row + 0.5f, 1.0f};
}

}  // namespace envgs
