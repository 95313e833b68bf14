// A surfel as the rasterizer sees it: its frame in pixel coordinates, computed once an image, so that a pixel needs one
// division and a handful of multiplications to find its hit (2D Gaussian Splatting).
#pragma once
#include "splat.h"
#include "surfel.h"

namespace envgs {

// R is float for one surfel a thread. Where several pixels are evaluated at once, R is the pixels' type and the splat
// stays scalar.
struct SurfelSplat {
    Vec3<float> origin;     // o' = A(camera center − p)
    Mat3<float> direction;  // d' = direction · (x, y, 1)
    float x, y, depth;      // the projected center
    float support, opacity;
    float screen_support;  // the low-pass's support; negative where it is off or the center nearer than near
};

template <class R>
struct SurfelPixel {
    PlaneHit<R> plane;
    R d_x, d_y;      // d'_x, d'_y
    R dx, dy;        // pixel − projected center
    R rho, t, side;  // side: +1 where the ray hits the front of the surfel (n·d < 0), else −1
    R screen;        // 1 where the low-pass's response is the larger one, else 0
};

// Σ over pixels; see SurfelMoments for the first, the rest belongs to the low-pass.
template <class R>
struct SurfelSums {
    SurfelMoments<R> moments;
    R x, y, depth;
};

struct SurfelInput {
    Vec3<float> mean;
    Quaternion<float> quaternion;
    float scale_u, scale_v;
};

// World frame; `side` of a pixel turns it toward the camera.
ENVGS_FN Vec3<float> normal_of(const SurfelInput& in) {
    float inverse_norm;
    return axes_of(normalized(in.quaternion, inverse_norm)).n;
}

// The box of the disc ρ ≤ r² in pixels. Where it lies in front of the camera its outline is an ellipse, whose extent
// follows from the dual conic r²(h_u h_uᵀ + h_v h_vᵀ) − h_c h_cᵀ, taken about the projected center to keep float
// accuracy; where it crosses the camera plane, the square around it is clipped at the near plane and projected.
ENVGS_FN PixelBox disc_box(const PinholeCamera& camera, const Projection& center, Vec3<float> axis_u,
                           Vec3<float> axis_v, float r2) {
    PixelBox empty = {1.0f, 1.0f, 0.0f, 0.0f};
    Vec3<float> hu = center.world_to_pixel * axis_u, hv = center.world_to_pixel * axis_v;
    float zc = center.in_camera.z, r = square_root(r2);
    float depth_extent = r * square_root(hu.z * hu.z + hv.z * hv.z);
    if (zc + depth_extent < camera.near) return empty;
    if (zc - depth_extent > 0.5f * camera.near) {
        float ux = hu.x - center.x * hu.z, uy = hu.y - center.y * hu.z;
        float vx = hv.x - center.x * hv.z, vy = hv.y - center.y * hv.z;
        float zz = r2 * (hu.z * hu.z + hv.z * hv.z) - zc * zc;
        float xz = r2 * (ux * hu.z + vx * hv.z), yz = r2 * (uy * hu.z + vy * hv.z);
        float xx = r2 * (ux * ux + vx * vx), yy = r2 * (uy * uy + vy * vy);
        float half_x = square_root(maximum(xz * xz - xx * zz, 0.0f)) / -zz;
        float half_y = square_root(maximum(yz * yz - yy * zz, 0.0f)) / -zz;
        float x = center.x + xz / zz, y = center.y + yz / zz;
        float slack = 0.01f + 1e-4f * (half_x + half_y);
        return {x - half_x - slack, y - half_y - slack, x + half_x + slack, y + half_y + slack};
    }
    Vec3<float> hc = camera.intrinsics * center.in_camera;
    PixelBox box = {kInfinity, kInfinity, -kInfinity, -kInfinity};
    Vec3<float> corner[4] = {hc + r * (hu + hv), hc + r * (hu - hv), hc - r * (hu + hv), hc + r * (hv - hu)};
    for (int i = 0; i < 4; ++i) {
        Vec3<float> a = corner[i], b = corner[(i + 1) & 3];
        if (a.z >= camera.near) box = merged(box, {a.x / a.z, a.y / a.z, a.x / a.z, a.y / a.z});
        if ((a.z >= camera.near) != (b.z >= camera.near)) {
            Vec3<float> c = a + ((camera.near - a.z) / (b.z - a.z)) * (b - a);
            box = merged(box, {c.x / c.z, c.y / c.z, c.x / c.z, c.y / c.z});
        }
    }
    return {box.x0 - 1.0f, box.y0 - 1.0f, box.x1 + 1.0f, box.y1 + 1.0f};
}

// Returns the pixels that may respond; empty where the surfel cannot be seen.
ENVGS_FN PixelBox prepare(const PinholeCamera& camera, const SurfelInput& in, float opacity, SurfelSplat& splat) {
    PixelBox empty = {1.0f, 1.0f, 0.0f, 0.0f};
    splat.support = support_of(opacity);
    if (!(splat.support > 0.0f)) return empty;
    float inverse_norm;
    Axes<float> axes = axes_of(normalized(in.quaternion, inverse_norm));
    SurfelFrame<float> frame = surfel_frame(axes, in.scale_u, in.scale_v);
    Projection center = project(camera, in.mean);
    Mat3<float> a = {frame.u, frame.v, frame.n};
    splat.origin = a * (camera.center - in.mean);
    splat.direction = a * camera.pixel_to_direction;
    splat.x = center.x, splat.y = center.y, splat.depth = center.in_camera.z;
    splat.opacity = opacity;
    splat.screen_support = camera.low_pass && splat.depth >= camera.near ? splat.support : -1.0f;
    PixelBox box = disc_box(camera, center, in.scale_u * axes.u, in.scale_v * axes.v, splat.support);
    if (splat.screen_support > 0.0f) {
        float radius = square_root(0.5f * splat.support) + 0.01f;
        PixelBox screen = {splat.x - radius, splat.y - radius, splat.x + radius, splat.y + radius};
        box = box.x0 > box.x1 ? screen : merged(box, screen);
    }
    return box;
}

// The splat's response at pixel position (x, y); a hit where out.rho <= splat.support.
template <class R>
ENVGS_FN SurfelPixel<R> evaluate(const SurfelSplat& s, R x, R y, float near) {
    SurfelPixel<R> out;
    out.d_x = s.direction.row0.x * x + (s.direction.row0.y * y + s.direction.row0.z);
    out.d_y = s.direction.row1.x * x + (s.direction.row1.y * y + s.direction.row1.z);
    R d_z = s.direction.row2.x * x + (s.direction.row2.y * y + s.direction.row2.z);
    out.plane.d_z = d_z;
    out.plane.inverse_d_z = 1.0f / d_z;
    out.plane.t = -s.origin.z * out.plane.inverse_d_z;
    out.plane.u = s.origin.x + out.plane.t * out.d_x;
    out.plane.v = s.origin.y + out.plane.t * out.d_y;
    out.side = select(d_z < 0.0f, broadcast<R>(1.0f), broadcast<R>(-1.0f));
    R infinite = broadcast<R>(kInfinity);
    R own = out.plane.u * out.plane.u + out.plane.v * out.plane.v;
    own = select((out.plane.t >= near) & (absolute(d_z) > kDirectionEpsilon) & (own < kInfinity), own, infinite);
    out.dx = x - s.x;
    out.dy = y - s.y;
    out.rho = own;
    out.t = out.plane.t;
    out.screen = broadcast<R>(0.0f);
    if (s.screen_support > 0.0f) {
        R filtered = 2.0f * (out.dx * out.dx + out.dy * out.dy);
        auto closer = filtered < own;
        out.rho = select(closer, filtered, own);
        out.t = select(closer, broadcast<R>(s.depth), out.plane.t);
        out.screen = select(closer, broadcast<R>(1.0f), broadcast<R>(0.0f));
    }
    return out;
}

// Adds a pixel where `hit` is set.
template <class R, class Mask>
ENVGS_FN void add_pixel(SurfelSums<R>& sum, SurfelPixel<R> p, Mask hit, R g_rho, R g_t) {
    R zero = broadcast<R>(0.0f);
    auto own = hit & (p.screen == 0.0f);
    auto screen = hit & (p.screen != 0.0f);
    PlaneHit<R> plane = {select(own, p.plane.t, zero), select(own, p.plane.u, zero), select(own, p.plane.v, zero),
                         p.plane.d_z, select(own, p.plane.inverse_d_z, zero)};
    R g_own = select(own, 2.0f * g_rho, zero);
    Vec3<R> g = intersect_backward(plane, p.d_x, p.d_y, g_t, g_own * plane.u, g_own * plane.v);
    add_hit(sum.moments, plane, g);
    R g_screen = select(screen, -4.0f * g_rho, zero);
    sum.x += g_screen * p.dx;
    sum.y += g_screen * p.dy;
    sum.depth += select(screen, g_t, zero);
}

struct SplatGradient {
    Vec3<float> mean;                // geometry only: the color's direction adds its own
    Vec3<float> position_statistic;  // Σ t·dL/dmean
    Quaternion<float> quaternion;
    Vec3<float> scales;  // the third of a surfel is 0
};

// g_normal: Σ w·side·dL/dnormal over the pixels, world frame.
ENVGS_FN SplatGradient finish(const PinholeCamera& camera, const SurfelInput& in, const SurfelSums<float>& sum,
                              Vec3<float> g_normal) {
    float inverse_norm;
    Quaternion<float> q = normalized(in.quaternion, inverse_norm);
    SurfelGradient<float> own = surfel_backward(axes_of(q), in.scale_u, in.scale_v, sum.moments, g_normal);
    Projection center = project(camera, in.mean);
    Vec3<float> screen = {0.0f, 0.0f, 0.0f};
    if (center.in_camera.z >= camera.near) screen = project_backward(center, sum.x, sum.y, sum.depth);
    Vec3<float> statistic = own.position_statistic;
    if (camera.low_pass_statistics) statistic = statistic + center.in_camera.z * screen;
    return {own.mean + screen,
            statistic,
            quaternion_gradient(q, inverse_norm, own.torque),
            {own.scale_u, own.scale_v, 0.0f}};
}

}  // namespace envgs
