// The rays that a drawn surface reflects, and their gradients: a thread a pixel.
#include "pixel_rays.cuh"

using namespace envgs;

// A pixel whose alpha or blended normal is too short, or whose β is not above `beta_min`, reflects nothing: its
// direction is zero, and so is its weight, otherwise β. `beta_min_at`, where there is one, says `beta_min` on the
// device.
extern "C" __global__ void __launch_bounds__(256)
    reflect_pixels(const PinholeCamera* camera,  // [1]
                   const float* alpha,           // [H, W] in [0, 1]
                   const float* depth,           // [H, W] camera-frame z
                   const float* normal,          // [3, H, W] world frame, blended, not normalized
                   const float* beta,            // [H, W] blended reflectivity
                   float offset,                 // origins lie this far above the surface, world units
                   float alpha_min,              // least alpha and length of the normal of a surface
                   float beta_min,               // least reflectivity that reflects
                   const float* beta_min_at,     // [1] beta_min on the device, or null
                   float* origins,               // [H, W, 3] world units
                   float* directions,            // [H, W, 3] unit, world frame; 0 where nothing reflects
                   float* weights                // [H, W] β; 0 where nothing reflects
    ) {
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
    differentiate_reflection(const PinholeCamera* camera,  // [1]
                             const float* normal,          // [3, H, W] world frame, blended, not normalized
                             const float* directions,      // [H, W, 3] as reflect_pixels wrote them
                             float offset,                 // origins lie this far above the surface, world units
                             const float* g_origins,       // [H, W, 3] dL/dorigins
                             const float* g_directions,    // [H, W, 3] dL/ddirections
                             const float* g_weights,       // [H, W] dL/dweights
                             float* g_depth,               // [H, W] dL/ddepth
                             float* g_normal,              // [3, H, W] dL/dnormal
                             float* g_beta                 // [H, W] dL/dβ
    ) {
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
