// The rays that a drawn surface reflects: a thread a pixel.
#include "kernels/splat.h"

using namespace envgs;

// A pixel whose alpha or blended normal is too short, or whose β is not above `beta_min`, reflects nothing: its direction
// is zero, and so is its weight, otherwise β. `beta_min_at`, where there is one, says `beta_min` on the device.
extern "C" __global__ void __launch_bounds__(256)
    reflect_pixels(const View* view, const float* alpha, const float* depth, const float* normal, const float* beta,
                   float offset, float alpha_min, float beta_min, const float* beta_min_at, float* origins,
                   float* directions, float* weights) {
    int i = blockIdx.x * blockDim.x + threadIdx.x, pixels = view->width * view->height;
    if (i >= pixels) return;
    Vec3<float> n = {normal[i], normal[pixels + i], normal[2 * pixels + i]};
    float squared = dot(n, n), weight = beta[i];
    if (beta_min_at) beta_min = *beta_min_at;
    bool reflects = alpha[i] > alpha_min && squared > alpha_min * alpha_min && weight > beta_min;
    n = rsqrtf(maximum(squared, 1e-24f)) * n;
    float column = i % view->width + 0.5f, row = i / view->width + 0.5f;
    Vec3<float> d = view->pixel_to_direction * Vec3<float>{column, row, 1.0f};
    store3(origins + 3l * i, view->centre + offset * n + depth[i] * d);
    d = inverse_length(d) * d;
    d = d - 2.0f * dot(d, n) * n;
    store3(directions + 3l * i, reflects ? d : Vec3<float>{0.0f, 0.0f, 0.0f});
    weights[i] = reflects ? weight : 0.0f;
}
