// A camera as kernels see it.
#include "kernels/splat.h"

using namespace envgs;

static_assert(sizeof(PinholeCamera) == 4 * CAMERA_FLOATS);

// One thread. The camera stays on the device, so that drawing never waits for it.
extern "C" __global__ void make_camera(
    const float* world_to_camera,  // [4, 4] rigid
    const float* intrinsics,       // [3, 3] pixels
    int width,                     // pixels
    int height,                    // pixels
    float near,                    // nearest depth that is drawn, world units
    int low_pass,                  // whether to anti-alias
    int low_pass_statistics,       // whether position statistics count what the low-pass of a surfel answers
    PinholeCamera* camera          // [1]
) {
    const float* m = world_to_camera;
    PinholeCamera v;
    v.rotation = {load3(m), load3(m + 4), load3(m + 8)};
    v.translation = {m[3], m[7], m[11]};
    v.intrinsics = load_mat3(intrinsics);
    v.center = -transposed_times(v.rotation, v.translation);
    // K is upper triangular with a last row of (0, 0, 1).
    double fx = intrinsics[0], skew = intrinsics[1], cx = intrinsics[2], fy = intrinsics[4], cy = intrinsics[5];
    Mat3<float> inverse = {{float(1 / fx), float(-skew / (fx * fy)), float((skew * cy - cx * fy) / (fx * fy))},
                           {0.0f, float(1 / fy), float(-cy / fy)},
                           {0.0f, 0.0f, 1.0f}};
    v.pixel_to_direction = transposed(v.rotation) * inverse;
    v.width = width, v.height = height, v.near = near;
    v.low_pass = low_pass, v.low_pass_statistics = low_pass_statistics;
    *camera = v;
}
