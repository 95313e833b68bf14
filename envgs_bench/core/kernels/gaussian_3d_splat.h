// A 3D Gaussian as the rasterizer sees it: its covariance carried to the image by the projection's local affine
// approximation (EWA splatting, 3D Gaussian Splatting). ρ = δᵀ·V⁻¹·δ with V = T·Σ·Tᵀ, T = J·W, Σ = R·S²·Rᵀ.
#pragma once
#include "surfel_splat.h"

namespace envgs {

constexpr float kDilation = 0.3f;       // px² added to V by the low-pass
constexpr float kFrustumMargin = 0.3f;  // the affine approximation is taken at most this share of the image's
                                        // half size outside the image

struct Gaussian3dSplat {
    float x, y, depth;  // the projected center
    float xx, xy, yy;   // V⁻¹
    float side;         // +1 where the shortest axis faces the camera, else −1
    float support, opacity;
};

template <class R>
struct Gaussian3dPixel {
    R dx, dy;
    R rho, t, side;
};

template <class R>
struct Gaussian3dSums {
    R xx, xy, yy;  // Σ dL/dρ·δδᵀ
    R x, y;        // Σ dL/dρ·δ
    R depth;       // Σ dL/dt
};

struct Gaussian3dInput {
    Vec3<float> mean;
    Quaternion<float> quaternion;
    Vec3<float> scales;
};

// The rows of T, and what its derivative needs.
struct AffineProjection {
    Vec3<float> t0, t1;   // rows of T, world frame
    float tx, ty;         // x/z and y/z, clamped
    bool free_x, free_y;  // not clamped
};

ENVGS_FN float clamped(float value, float low, float high) { return minimum(maximum(value, low), high); }

ENVGS_FN AffineProjection affine_projection(const PinholeCamera& camera, Vec3<float> in_camera) {
    float fx = camera.intrinsics.row0.x, skew = camera.intrinsics.row0.y, cx = camera.intrinsics.row0.z;
    float fy = camera.intrinsics.row1.y, cy = camera.intrinsics.row1.z;
    float margin_x = kFrustumMargin * 0.5f * camera.width / fx, margin_y = kFrustumMargin * 0.5f * camera.height / fy;
    AffineProjection a;
    float x = in_camera.x / in_camera.z, y = in_camera.y / in_camera.z;
    a.tx = clamped(x, -cx / fx - margin_x, (camera.width - cx) / fx + margin_x);
    a.ty = clamped(y, -cy / fy - margin_y, (camera.height - cy) / fy + margin_y);
    a.free_x = a.tx == x;
    a.free_y = a.ty == y;
    float inverse = 1.0f / in_camera.z;
    Vec3<float> j0 = {fx * inverse, skew * inverse, -(fx * a.tx + skew * a.ty) * inverse};
    Vec3<float> j1 = {0.0f, fy * inverse, -fy * a.ty * inverse};
    a.t0 = transposed_times(camera.rotation, j0);
    a.t1 = transposed_times(camera.rotation, j1);
    return a;
}

ENVGS_FN int shortest_axis(Vec3<float> scales) {
    int k = scales.y < scales.x ? 1 : 0;
    return scales.z < (k ? scales.y : scales.x) ? 2 : k;
}

// The world-frame normal: the shortest axis, its sign arbitrary; `side` turns it toward the camera.
ENVGS_FN Vec3<float> shortest_axis_of(Axes<float> axes, Vec3<float> scales) {
    int k = shortest_axis(scales);
    return k == 0 ? axes.u : k == 1 ? axes.v : axes.n;
}

ENVGS_FN Vec3<float> normal_of(const Gaussian3dInput& in) {
    float inverse_norm;
    return shortest_axis_of(axes_of(normalized(in.quaternion, inverse_norm)), in.scales);
}

struct Covariance2d {
    float xx, xy, yy;
};

ENVGS_FN Covariance2d covariance(const PinholeCamera& camera, const AffineProjection& a, Axes<float> axes,
                                 Vec3<float> s) {
    // Rows of T·R·S: V is their Gram matrix.
    Vec3<float> m0 = {s.x * dot(a.t0, axes.u), s.y * dot(a.t0, axes.v), s.z * dot(a.t0, axes.n)};
    Vec3<float> m1 = {s.x * dot(a.t1, axes.u), s.y * dot(a.t1, axes.v), s.z * dot(a.t1, axes.n)};
    float dilation = camera.low_pass ? kDilation : 0.0f;
    return {dot(m0, m0) + dilation, dot(m0, m1), dot(m1, m1) + dilation};
}

ENVGS_FN PixelBox prepare(const PinholeCamera& camera, const Gaussian3dInput& in, float opacity,
                          Gaussian3dSplat& splat) {
    PixelBox empty = {1.0f, 1.0f, 0.0f, 0.0f};
    splat.support = support_of(opacity);
    splat.opacity = opacity;
    if (!(splat.support > 0.0f)) return empty;
    Projection center = project(camera, in.mean);
    splat.x = center.x, splat.y = center.y, splat.depth = center.in_camera.z;
    if (!(splat.depth >= camera.near)) return empty;
    float inverse_norm;
    Axes<float> axes = axes_of(normalized(in.quaternion, inverse_norm));
    Covariance2d v = covariance(camera, affine_projection(camera, center.in_camera), axes, in.scales);
    float determinant = v.xx * v.yy - v.xy * v.xy;
    if (!(determinant > 0.0f)) return empty;
    float inverse = 1.0f / determinant;
    splat.xx = v.yy * inverse, splat.xy = -v.xy * inverse, splat.yy = v.xx * inverse;
    splat.side = dot(shortest_axis_of(axes, in.scales), in.mean - camera.center) < 0.0f ? 1.0f : -1.0f;
    float half_x = square_root(splat.support * v.xx) + 0.01f, half_y = square_root(splat.support * v.yy) + 0.01f;
    return {splat.x - half_x, splat.y - half_y, splat.x + half_x, splat.y + half_y};
}

template <class R>
ENVGS_FN Gaussian3dPixel<R> evaluate(const Gaussian3dSplat& s, R x, R y, float /*near*/) {
    R dx = x - s.x, dy = y - s.y;
    R rho = dx * (s.xx * dx + 2.0f * s.xy * dy) + s.yy * dy * dy;
    return {dx, dy, rho, broadcast<R>(s.depth), broadcast<R>(s.side)};
}

template <class R, class Mask>
ENVGS_FN void add_pixel(Gaussian3dSums<R>& sum, Gaussian3dPixel<R> p, Mask hit, R g_rho, R g_t) {
    R g = select(hit, g_rho, broadcast<R>(0.0f));
    R gx = g * p.dx, gy = g * p.dy;
    sum.xx += gx * p.dx;
    sum.xy += gx * p.dy;
    sum.yy += gy * p.dy;
    sum.x += gx;
    sum.y += gy;
    sum.depth += select(hit, g_t, broadcast<R>(0.0f));
}

ENVGS_FN SplatGradient finish(const PinholeCamera& camera, const Gaussian3dInput& in, const Gaussian3dSums<float>& sum,
                              Vec3<float> g_normal) {
    float inverse_norm;
    Quaternion<float> q = normalized(in.quaternion, inverse_norm);
    Axes<float> axes = axes_of(q);
    Projection center = project(camera, in.mean);
    AffineProjection a = affine_projection(camera, center.in_camera);
    Covariance2d v = covariance(camera, a, axes, in.scales);
    float inverse_det = 1.0f / (v.xx * v.yy - v.xy * v.xy);
    float cxx = v.yy * inverse_det, cxy = -v.xy * inverse_det, cyy = v.xx * inverse_det;
    // dL/dV = −V⁻¹·(Σ g δδᵀ)·V⁻¹
    float px = cxx * sum.xx + cxy * sum.xy, py = cxx * sum.xy + cxy * sum.yy;
    float qx = cxy * sum.xx + cyy * sum.xy, qy = cxy * sum.xy + cyy * sum.yy;
    float g_xx = -(px * cxx + py * cxy), g_xy = -(px * cxy + py * cyy), g_yy = -(qx * cxy + qy * cyy);
    // dL/dΣ in the local frame: Q = (T·R)ᵀ·dL/dV·(T·R)
    Vec3<float> m0 = {dot(a.t0, axes.u), dot(a.t0, axes.v), dot(a.t0, axes.n)};
    Vec3<float> m1 = {dot(a.t1, axes.u), dot(a.t1, axes.v), dot(a.t1, axes.n)};
    Vec3<float> w0 = g_xx * m0 + g_xy * m1, w1 = g_xy * m0 + g_yy * m1;
    Vec3<float> s = in.scales, s2 = {s.x * s.x, s.y * s.y, s.z * s.z};
    float q01 = m0.x * w0.y + m1.x * w1.y, q02 = m0.x * w0.z + m1.x * w1.z, q12 = m0.y * w0.z + m1.y * w1.z;
    Vec3<float> g_scales = {2.0f * s.x * (m0.x * w0.x + m1.x * w1.x), 2.0f * s.y * (m0.y * w0.y + m1.y * w1.y),
                            2.0f * s.z * (m0.z * w0.z + m1.z * w1.z)};
    Vec3<float> torque = {2.0f * q12 * (s2.y - s2.z), 2.0f * q02 * (s2.z - s2.x), 2.0f * q01 * (s2.x - s2.y)};
    Vec3<float> g_local = {dot(axes.u, g_normal), dot(axes.v, g_normal), dot(axes.n, g_normal)};
    int k = shortest_axis(s);
    Vec3<float> axis = {k == 0 ? 1.0f : 0.0f, k == 1 ? 1.0f : 0.0f, k == 2 ? 1.0f : 0.0f};
    torque = torque + cross(axis, g_local);
    // dL/dT = 2·dL/dV·T·Σ, rows; then J's dependence on the center.
    Vec3<float> r0 = {2.0f * s2.x * w0.x, 2.0f * s2.y * w0.y, 2.0f * s2.z * w0.z};
    Vec3<float> r1 = {2.0f * s2.x * w1.x, 2.0f * s2.y * w1.y, 2.0f * s2.z * w1.z};
    Vec3<float> g_j0 = camera.rotation * (r0.x * axes.u + r0.y * axes.v + r0.z * axes.n);
    Vec3<float> g_j1 = camera.rotation * (r1.x * axes.u + r1.y * axes.v + r1.z * axes.n);
    float fx = camera.intrinsics.row0.x, skew = camera.intrinsics.row0.y, fy = camera.intrinsics.row1.y;
    float inverse = 1.0f / center.in_camera.z;
    float g_tx = a.free_x ? -fx * inverse * g_j0.z : 0.0f;
    float g_ty = a.free_y ? -inverse * (skew * g_j0.z + fy * g_j1.z) : 0.0f;
    float g_z = -inverse * inverse * (fx * g_j0.x + skew * g_j0.y + fy * g_j1.y) +
                inverse * inverse * ((fx * a.tx + skew * a.ty) * g_j0.z + fy * a.ty * g_j1.z) -
                inverse * (g_tx * a.tx + g_ty * a.ty);
    Vec3<float> through_j = transposed_times(camera.rotation, {inverse * g_tx, inverse * g_ty, g_z});
    float g_x = -2.0f * (cxx * sum.x + cxy * sum.y), g_y = -2.0f * (cxy * sum.x + cyy * sum.y);
    Vec3<float> mean = project_backward(center, g_x, g_y, sum.depth) + through_j;
    return {mean, center.in_camera.z * mean, quaternion_gradient(q, inverse_norm, torque), g_scales};
}

}  // namespace envgs
