// What rasterizing a surfel and rasterizing a 3D Gaussian have in common: the camera, the pixels that a primitive may
// touch, and the color that it shows to the camera.
#pragma once
#include "blend.h"
#include "sh.h"

namespace envgs {

// A camera and how it draws; `Camera` in Python.
struct PinholeCamera {
    Mat3<float> rotation;  // world to camera
    Vec3<float> translation;
    Mat3<float> intrinsics;
    Mat3<float> pixel_to_direction;  // (x, y, 1) -> world direction with camera z = 1
    Vec3<float> center;              // world
    int width, height;               // pixels
    float near;                      // nearest camera-frame depth that is drawn, world units
    bool low_pass;                   // whether to anti-alias
    bool low_pass_statistics;        // whether position statistics count what the low-pass of a surfel answers
};

// Pixel positions that may respond; empty where x0 > x1.
struct PixelBox {
    float x0, y0, x1, y1;
};

ENVGS_FN PixelBox merged(PixelBox a, PixelBox b) {
    return {minimum(a.x0, b.x0), minimum(a.y0, b.y0), maximum(a.x1, b.x1), maximum(a.y1, b.y1)};
}

// A pinhole projection of one point, and what turns pixel gradients into world ones.
struct Projection {
    Vec3<float> in_camera;
    float x, y;                  // pixels
    Mat3<float> world_to_pixel;  // K·R: homogeneous
};

ENVGS_FN Projection project(const PinholeCamera& camera, Vec3<float> point) {
    Projection out;
    out.in_camera = camera.rotation * point + camera.translation;
    Vec3<float> h = camera.intrinsics * out.in_camera;
    out.x = h.x / h.z;
    out.y = h.y / h.z;
    out.world_to_pixel = camera.intrinsics * camera.rotation;
    return out;
}

// dL/dpoint from the gradient of the projected position and of the camera-frame depth.
ENVGS_FN Vec3<float> project_backward(const Projection& p, float g_x, float g_y, float g_depth) {
    float inverse = 1.0f / p.in_camera.z;
    Vec3<float> dx = inverse * (p.world_to_pixel.row0 - p.x * p.world_to_pixel.row2);
    Vec3<float> dy = inverse * (p.world_to_pixel.row1 - p.y * p.world_to_pixel.row2);
    return g_x * dx + g_y * dy + g_depth * p.world_to_pixel.row2;
}

// 1/|v|, and 0 for the zero vector, which so has the direction 0 and gets no gradient.
ENVGS_FN float inverse_length(Vec3<float> v) {
    float l = length(v);
    return l > 0.0f ? 1.0f / l : 0.0f;
}

// A color from its channels' sums, none below 0. A negative sum becomes −0, which is drawn as 0 is and tells the
// backward pass of it.
ENVGS_FN Vec3<float> clamped_color(Vec3<float> sum) {
    return {maximum(-0.0f, sum.x), maximum(-0.0f, sum.y), maximum(-0.0f, sum.z)};  // in this order: NaN and 0 stay
}

// dL/dsum of a channel from dL/dcolor: 0 where the sum was negative or NaN.
ENVGS_FN float unclamped_gradient(float color, float g) {
    return color >= 0.0f && copysignf(1.0f, color) > 0.0f ? g : 0.0f;
}
ENVGS_FN Vec3<float> unclamped_gradient(Vec3<float> color, Vec3<float> g) {
    return {unclamped_gradient(color.x, g.x), unclamped_gradient(color.y, g.y), unclamped_gradient(color.z, g.z)};
}

// The color of SH coefficients seen along v = mean − origin. `sh` is [K][3]. The ½ comes last, to a rounded sum: one
// that is −½ in float gives 0 and not what a fused multiply-add would leave.
template <int Degree>
ENVGS_FN Vec3<float> sh_color(const float* sh, Vec3<float> v) {
    constexpr int K = (Degree + 1) * (Degree + 1);
    float basis[K];
    sh_basis<Degree>(inverse_length(v) * v, basis);
    Vec3<float> c = {0.0f, 0.0f, 0.0f};
    for (int k = 0; k < K; ++k) c = c + basis[k] * load3(sh + 3 * k);
    return clamped_color(c + Vec3<float>{0.5f, 0.5f, 0.5f});
}

// Adds dL/dsh to g_sh and returns dL/dv; `color` is what sh_color returned.
template <int Degree>
ENVGS_FN Vec3<float> sh_color_backward(const float* sh, Vec3<float> v, Vec3<float> color, Vec3<float> g, float* g_sh) {
    constexpr int K = (Degree + 1) * (Degree + 1);
    float inverse = inverse_length(v);
    Vec3<float> d = inverse * v;
    g = unclamped_gradient(color, g);
    float basis[K], g_basis[K];
    sh_basis<Degree>(d, basis);
    for (int k = 0; k < K; ++k) {
        g_basis[k] = dot(g, load3(sh + 3 * k));
        store3(g_sh + 3 * k, load3(g_sh + 3 * k) + basis[k] * g);
    }
    return normalize_backward(d, inverse, sh_basis_backward<Degree>(d, g_basis));
}

}  // namespace envgs
