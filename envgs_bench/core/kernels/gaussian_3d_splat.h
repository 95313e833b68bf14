// A 3D Gaussian as the rasterizer sees it: its covariance carried to the image by the projection's local affine
// approximation (EWA splatting, 3D Gaussian Splatting). ρ = δᵀ·V⁻¹·δ with V = T·Σ·Tᵀ, T = J·W, Σ = R·S²·Rᵀ.
//
// A needle's V is all but singular: xx·yy − xy² and products with V⁻¹ would be off by rounding times the square of its
// length over its width. So V is factored as L·Lᵀ (Cholesky), its width by a cross product of the rows of T·R·S, and
// a pixel has z = L⁻¹·δ, ρ = |z|².
#pragma once
#include "surfel_splat.h"

namespace envgs {

constexpr float kDilation = 0.3f;       // px² added to V by the low-pass
constexpr float kFrustumMargin = 0.3f;  // the affine approximation is taken at most this share of the image's
                                        // half size outside the image

struct Gaussian3dSplat {
    float x, y, depth;  // the projected center
    float xx, yx, yy;   // L⁻¹, which is lower triangular
    float side;         // +1 where the shortest axis faces the camera, else −1
    float support, opacity;
};

template <class R>
struct Gaussian3dPixel {
    R zx, zy;
    R rho, t, side;
};

template <class R>
struct Gaussian3dSums {
    R xx, xy, yy;  // Σ dL/dρ·zzᵀ
    R x, y;        // Σ dL/dρ·z
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

// V and its factor, and what the factor's derivative needs.
struct ProjectedCovariance {
    float xx, yy;         // V's diagonal
    float lxx, lyx, lyy;  // L⁻¹
    Vec3<float> w0, w1;   // rows of L⁻¹·T·R
};

ENVGS_FN ProjectedCovariance projected_covariance(const PinholeCamera& camera, const AffineProjection& a,
                                                  Axes<float> axes, Vec3<float> s) {
    Vec3<float> p0 = {dot(a.t0, axes.u), dot(a.t0, axes.v), dot(a.t0, axes.n)};  // rows of T·R
    Vec3<float> p1 = {dot(a.t1, axes.u), dot(a.t1, axes.v), dot(a.t1, axes.n)};
    Vec3<float> m0 = {s.x * p0.x, s.y * p0.y, s.z * p0.z}, m1 = {s.x * p1.x, s.y * p1.y, s.z * p1.z};
    float dilation = camera.low_pass ? kDilation : 0.0f;
    ProjectedCovariance v;
    v.xx = dot(m0, m0) + dilation, v.yy = dot(m1, m1) + dilation;
    v.lxx = 1.0f / square_root(v.xx);
    // Of y's variance, what x does not tell: det V / xx = (|m0 × m1|² + d·(|m0|² + |m1|²) + d²) / xx.
    Vec3<float> across = cross(v.lxx * m0, m1);
    float left = dot(across, across) + dilation * (1.0f + v.lxx * v.lxx * dot(m1, m1));
    v.lyy = 1.0f / square_root(left);
    v.lyx = -v.lyy * v.lxx * v.lxx * dot(m0, m1);
    // p1 − (xy/xx)·p0 = ((p0 × p1) × S²·p0 + d·p1) / xx
    Vec3<float> s2p0 = {s.x * m0.x, s.y * m0.y, s.z * m0.z};
    v.w0 = v.lxx * p0;
    v.w1 = v.lyy * v.lxx * v.lxx * (cross(cross(p0, p1), s2p0) + dilation * p1);
    return v;
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
    ProjectedCovariance v = projected_covariance(camera, affine_projection(camera, center.in_camera), axes, in.scales);
    if (!(v.lxx > 0.0f && v.lyy > 0.0f && v.lxx < kInfinity && v.lyy < kInfinity)) return empty;
    splat.xx = v.lxx, splat.yx = v.lyx, splat.yy = v.lyy;
    splat.side = dot(shortest_axis_of(axes, in.scales), in.mean - camera.center) < 0.0f ? 1.0f : -1.0f;
    float half_x = square_root(splat.support * v.xx) + 0.01f, half_y = square_root(splat.support * v.yy) + 0.01f;
    return {splat.x - half_x, splat.y - half_y, splat.x + half_x, splat.y + half_y};
}

template <class R>
ENVGS_FN Gaussian3dPixel<R> evaluate(const Gaussian3dSplat& s, R x, R y, float /*near*/) {
    R dx = x - s.x, dy = y - s.y;
    R zx = s.xx * dx, zy = s.yx * dx + s.yy * dy;
    return {zx, zy, zx * zx + zy * zy, broadcast<R>(s.depth), broadcast<R>(s.side)};
}

template <class R, class Mask>
ENVGS_FN void add_pixel(Gaussian3dSums<R>& sum, Gaussian3dPixel<R> p, Mask hit, R g_rho, R g_t) {
    R g = select(hit, g_rho, broadcast<R>(0.0f));
    R gx = g * p.zx, gy = g * p.zy;
    sum.xx += gx * p.zx;
    sum.xy += gx * p.zy;
    sum.yy += gy * p.zy;
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
    ProjectedCovariance v = projected_covariance(camera, a, axes, in.scales);
    // dL/dV = −L⁻ᵀ·Z·L⁻¹ with Z = Σ g zzᵀ. So with W = L⁻¹·T·R, dL/dΣ in the local frame is Q = Wᵀ·G, G = −Z·W.
    Vec3<float> g0 = -(sum.xx * v.w0 + sum.xy * v.w1), g1 = -(sum.xy * v.w0 + sum.yy * v.w1);
    Vec3<float> s = in.scales, s2 = {s.x * s.x, s.y * s.y, s.z * s.z};
    float q01 = v.w0.x * g0.y + v.w1.x * g1.y, q02 = v.w0.x * g0.z + v.w1.x * g1.z;
    float q12 = v.w0.y * g0.z + v.w1.y * g1.z;
    Vec3<float> g_scales = {2.0f * s.x * (v.w0.x * g0.x + v.w1.x * g1.x), 2.0f * s.y * (v.w0.y * g0.y + v.w1.y * g1.y),
                            2.0f * s.z * (v.w0.z * g0.z + v.w1.z * g1.z)};
    Vec3<float> torque = {2.0f * q12 * (s2.y - s2.z), 2.0f * q02 * (s2.z - s2.x), 2.0f * q01 * (s2.x - s2.y)};
    Vec3<float> g_local = {dot(axes.u, g_normal), dot(axes.v, g_normal), dot(axes.n, g_normal)};
    int k = shortest_axis(s);
    Vec3<float> axis = {k == 0 ? 1.0f : 0.0f, k == 1 ? 1.0f : 0.0f, k == 2 ? 1.0f : 0.0f};
    torque = torque + cross(axis, g_local);
    // dL/dT = 2·dL/dV·T·Σ = 2·L⁻ᵀ·G·S²·Rᵀ; then J's dependence on the center: by x/z, by y/z, and by the factor 1/z,
    // which does to V what a factor of all scales does, so that it adds Σ s·dL/ds to −z·dL/dz.
    Vec3<float> h0 = 2.0f * (v.lxx * g0 + v.lyx * g1), h1 = 2.0f * v.lyy * g1;
    Vec3<float> depth_axis = camera.rotation.row2;
    Vec3<float> toward = {s2.x * dot(axes.u, depth_axis), s2.y * dot(axes.v, depth_axis),
                          s2.z * dot(axes.n, depth_axis)};
    float g_j0z = dot(h0, toward), g_j1z = dot(h1, toward);
    float fx = camera.intrinsics.row0.x, skew = camera.intrinsics.row0.y, fy = camera.intrinsics.row1.y;
    float inverse = 1.0f / center.in_camera.z;
    float g_tx = a.free_x ? -fx * inverse * g_j0z : 0.0f;
    float g_ty = a.free_y ? -inverse * (skew * g_j0z + fy * g_j1z) : 0.0f;
    float g_z = -inverse * (dot(s, g_scales) + g_tx * a.tx + g_ty * a.ty);
    Vec3<float> through_j = transposed_times(camera.rotation, {inverse * g_tx, inverse * g_ty, g_z});
    float g_x = -2.0f * (v.lxx * sum.x + v.lyx * sum.y), g_y = -2.0f * v.lyy * sum.y;
    Vec3<float> mean = project_backward(center, g_x, g_y, sum.depth) + through_j;
    return {mean, center.in_camera.z * mean, quaternion_gradient(q, inverse_norm, torque), g_scales};
}

}  // namespace envgs
