// A surfel: where a ray intersects its plane, its response there, and the derivatives of both.
//
// The surfel's frame A maps the world to its plane, A = diag(1/s_u, 1/s_v, 1)·Rᵀ, with R's columns t_u, t_v, n. A ray o
// + t·d becomes o' + t·d' with o' = A(o − p) and d' = A·d, and intersects the plane at t = −o'_z/d'_z in (u, v),
// measured in standard deviations; ρ = u² + v² (EnvGS, Eq. 1, 6 and 12).
#pragma once
#include "quaternion.h"

namespace envgs {

template <class R>
struct SurfelFrame {
    Vec3<R> u, v, n;  // the rows of A: t_u/s_u, t_v/s_v, n
};

template <class R>
ENVGS_FN SurfelFrame<R> surfel_frame(Axes<R> axes, R scale_u, R scale_v) {
    return {(1.0f / scale_u) * axes.u, (1.0f / scale_v) * axes.v, axes.n};
}

// ρ at the edge of the support: min(3², 2·ln(255·opacity)). Negative where the primitive is nowhere visible.
ENVGS_FN float support_of(float opacity) {
    return opacity > 0.0f ? minimum(kMaxSupport, 2.0f * logf(255.0f * opacity)) : -1.0f;
}

// Whether ρ lies within the support, asked of the alpha there instead of a logarithm.
ENVGS_FN bool within_support(float rho, float alpha) { return rho <= kMaxSupport && alpha >= 1.0f / 255.0f; }

template <class R>
struct PlaneHit {
    R t, u, v;
    R d_z, inverse_d_z;  // n·d and its inverse: negative where the ray hits the surfel's front
};

// The hit of a ray given relative to the surfel's center (o − p) and in world axes.
template <class R>
ENVGS_FN PlaneHit<R> intersect(SurfelFrame<R> frame, Vec3<R> origin, Vec3<R> direction) {
    PlaneHit<R> hit;
    hit.d_z = dot(frame.n, direction);
    hit.inverse_d_z = 1.0f / hit.d_z;
    hit.t = -dot(frame.n, origin) * hit.inverse_d_z;
    Vec3<R> x = origin + hit.t * direction;
    hit.u = dot(frame.u, x);
    hit.v = dot(frame.v, x);
    return hit;
}

// dL/do' from dL/dt, dL/du and dL/dv. The rest follows from it: dL/dd' = t·dL/do' (a step of d moves the hit t times as
// far as a step of o), dL/do = Aᵀ·dL/do', dL/dd = t·dL/do, dL/dp = −dL/do (EnvGS, Eq. 13 and 14).
template <class R>
ENVGS_FN Vec3<R> intersect_backward(PlaneHit<R> hit, R d_x, R d_y, R g_t, R g_u, R g_v) {
    return {g_u, g_v, -(g_t + g_u * d_x + g_v * d_y) * hit.inverse_d_z};
}

// What the backward pass sums over a surfel's hits. Since dL/dA = Σ g ⊗ (x − p) and x − p = s_u·u·t_u + s_v·v·t_v lies
// in the plane, nine numbers hold the gradient of mean, rotation and scales; `g_t` gives the position statistic.
template <class R>
struct SurfelMoments {
    Vec3<R> g;    // Σ g, g = dL/do' of a hit
    Vec3<R> g_u;  // Σ g·u
    Vec3<R> g_v;  // Σ g·v
    Vec3<R> g_t;  // Σ g·t
};

template <class R>
ENVGS_FN void add_hit(SurfelMoments<R>& sum, PlaneHit<R> hit, Vec3<R> g) {
    sum.g = sum.g + g;
    sum.g_u = sum.g_u + hit.u * g;
    sum.g_v = sum.g_v + hit.v * g;
    sum.g_t = sum.g_t + hit.t * g;
}

template <class R>
struct SurfelGradient {
    Vec3<R> mean;
    R scale_u, scale_v;
    Vec3<R> torque;              // gradient of a small rotation about the local axes: see quaternion_gradient
    Vec3<R> position_statistic;  // Σ t·dL/dmean
};

// g_normal: dL/dn summed over the hits, each with the sign that turned n toward its viewer; world frame.
template <class R>
ENVGS_FN SurfelGradient<R> surfel_backward(Axes<R> axes, R scale_u, R scale_v, SurfelMoments<R> sum, Vec3<R> g_normal) {
    SurfelGradient<R> out;
    SurfelFrame<R> frame = surfel_frame(axes, scale_u, scale_v);
    out.mean = -(sum.g.x * frame.u + sum.g.y * frame.v + sum.g.z * frame.n);
    out.position_statistic = -(sum.g_t.x * frame.u + sum.g_t.y * frame.v + sum.g_t.z * frame.n);
    out.scale_u = -sum.g_u.x / scale_u;
    out.scale_v = -sum.g_v.y / scale_v;
    out.torque = {-scale_v * sum.g_v.z - dot(axes.v, g_normal), scale_u * sum.g_u.z + dot(axes.u, g_normal),
                  (scale_v / scale_u) * sum.g_v.x - (scale_u / scale_v) * sum.g_u.y};
    return out;
}

}  // namespace envgs
