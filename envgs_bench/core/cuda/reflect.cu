// The rays that a drawn surface reflects, and their gradients: a thread a pixel.
#include "pixel_rays.cuh"

using namespace envgs;

// A pixel whose alpha or blended normal is too short, or whose β is not above `beta_min`, reflects nothing: its direction
// is zero, and so is its weight, otherwise β. `beta_min_at`, where there is one, says `beta_min` on the device.
extern "C" __global__ void __launch_bounds__(256)
    reflect_pixels(const PinholeCamera* camera, const float* alpha, const float* depth, const float* normal, const float* beta,
                   float offset, float alpha_min, float beta_min, const float* beta_min_at, float* origins,
                   float* directions, float* weights) {
    int i = blockIdx.x * blockDim.x + threadIdx.x, pixels = camera->width * camera->height;
    if (i >= pixels) return;
    Vec3<float> n = {normal[i], normal[pixels + i], normal[2 * pixels + i]};
    float squared = dot(n, n), weight = beta[i];
    if (beta_min_at) beta_min = *beta_min_at;
    bool reflects = alpha[i] > alpha_min && squared > alpha_min * alpha_min && weight > beta_min;
    n = rsqrtf(maximum(squared, 1e-24f)) * n;
    Vec3<float> d = ray_through(*camera, i % camera->width, i / camera->width);
    store3(origins + 3l * i, camera->center + offset * n + depth[i] * d);
    d = inverse_length(d) * d;
    d = d - 2.0f * dot(d, n) * n;
    store3(directions + 3l * i, reflects ? d : Vec3<float>{0.0f, 0.0f, 0.0f});
    weights[i] = reflects ? weight : 0.0f;
}

// From the gradients of `reflect_pixels`' outputs to those of depth, normal and β. A pixel that reflects is one whose
// direction is not zero.
extern "C" __global__ void __launch_bounds__(256)
    differentiate_reflection(const PinholeCamera* camera, const float* normal, const float* directions, float offset,
                             const float* g_origins, const float* g_directions, const float* g_weights, float* g_depth,
                             float* g_normal, float* g_beta) {
    int i = blockIdx.x * blockDim.x + threadIdx.x, pixels = camera->width * camera->height;
    if (i >= pixels) return;
    Vec3<float> n = {normal[i], normal[pixels + i], normal[2 * pixels + i]};
    Vec3<float> mirrored = load3(directions + 3l * i), g_o = load3(g_origins + 3l * i);
    float squared = dot(n, n), scale = rsqrtf(maximum(squared, 1e-24f));
    bool reflects = mirrored.x != 0.0f || mirrored.y != 0.0f || mirrored.z != 0.0f;
    n = scale * n;
    Vec3<float> d = ray_through(*camera, i % camera->width, i / camera->width), g_n = offset * g_o;
    g_depth[i] = dot(g_o, d);
    if (reflects) {
        Vec3<float> g_d = load3(g_directions + 3l * i);
        d = inverse_length(d) * d;
        g_n = g_n - 2.0f * (dot(g_d, n) * d + dot(d, n) * g_d);
    }
    if (squared > 1e-24f) g_n = g_n - dot(g_n, n) * n;
    g_normal[i] = scale * g_n.x, g_normal[pixels + i] = scale * g_n.y, g_normal[2 * pixels + i] = scale * g_n.z;
    g_beta[i] = reflects ? g_weights[i] : 0.0f;
}
