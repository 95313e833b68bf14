// Colors of eight primitives at a time, one a lane, and their derivative: see sh_color and sh_color_backward.
#pragma once
#include "gaussians.h"

namespace envgs {

constexpr int kGroup = 8;
constexpr int kMaxCoefficients = 16;
using Float4 = LaneTypes<4>::Float;  // red, green, blue, and a lane that nobody reads

// Eight primitives' colors and where they are seen from.
struct SeenColors {
    Vec3<Float8> direction;          // unit, or zero
    Float8 inverse_length;           // of what it was before
    Float8 basis[kMaxCoefficients];  // SH, or sites' weights
    Float4 color[kGroup];
};

// See clamped_color and unclamped_gradient.
inline Float4 clamped_color(Float4 sum) { return maximum(-Float4{}, sum); }
inline Float4 unclamped_gradient(Float4 color, Float4 g) {
    using Int4 = LaneTypes<4>::Int;
    return select((color >= 0.0f) & ((Int4)color >= 0), g, Float4{});
}

// Row k of SH coefficients [K][3]. The fourth lane is the next row's first value; after the last row it is 0.
template <int K>
inline Float4 sh_row(const float* sh, int k) {
    if (k + 1 < K) return load_lanes<Float4>(sh + 3 * k);
    Float4 last = {sh[3 * k], sh[3 * k + 1], sh[3 * k + 2], 0.0f};
    return last;
}

template <int Degree>
inline void see_colors(const float* const (&sh)[kGroup], int count, Vec3<Float8> v, SeenColors& seen) {
    constexpr int K = (Degree + 1) * (Degree + 1);
    Float8 l = length(v);
    seen.inverse_length = select(l > 0.0f, 1.0f / l, Float8{});
    seen.direction = seen.inverse_length * v;
    sh_basis<Degree>(seen.direction, seen.basis);
    for (int lane = 0; lane < count; ++lane) {
        Float4 color = {};
        for (int k = 0; k < K; ++k) color = color + seen.basis[k][lane] * sh_row<K>(sh[lane], k);
        seen.color[lane] = clamped_color(color + 0.5f);
    }
}

inline Vec3<float> lane_of(Vec3<Float8> v, int lane) { return {v.x[lane], v.y[lane], v.z[lane]}; }

inline void see_sites(const float* const (&sites)[kGroup], int count, Vec3<Float8> v, SeenColors& seen) {
    Float8 l = length(v);
    seen.inverse_length = select(l > 0.0f, 1.0f / l, Float8{});
    seen.direction = seen.inverse_length * v;
    for (int lane = 0; lane < count; ++lane) {
        float weights[kSites];
        site_weights(sites[lane], lane_of(seen.direction, lane), weights);
        Float4 color = {};
        for (int k = 0; k < kSites; ++k) {
            seen.basis[k][lane] = weights[k];
            color = color + weights[k] * load_lanes<Float4>(sites[lane] + kSiteFloats * k);
        }
        seen.color[lane] = clamped_color(color);
    }
}

// The first `count` lanes' colors: the set's rows in `sh`, seen along v = mean − origin.
inline void see_colors(const Gaussians& g, const float* const (&sh)[kGroup], int count, Vec3<Float8> v,
                       SeenColors& seen) {
    if (g.has_sites) return see_sites(sh, count, v, seen);
    with_degree(g.sh_coefficients, [&](auto degree) { see_colors<degree>(sh, count, v, seen); });
}

template <int Degree>
inline Vec3<Float8> see_colors_backward(const float* const (&sh)[kGroup], int count, const SeenColors& seen,
                                        const Float4 (&gradient)[kGroup], float* const (&g_sh)[kGroup]) {
    constexpr int K = (Degree + 1) * (Degree + 1);
    Float8 g_basis[K] = {};
    for (int lane = 0; lane < count; ++lane) {
        Float4 g = unclamped_gradient(seen.color[lane], gradient[lane]);
        for (int k = 0; k < K; ++k) {
            const float* row = sh[lane] + 3 * k;
            g_basis[k][lane] = g[0] * row[0] + g[1] * row[1] + g[2] * row[2];
            float* sum = g_sh[lane] + 4 * k;
            store_lanes(sum, load_lanes<Float4>(sum) + seen.basis[k][lane] * g);
        }
    }
    return normalize_backward(seen.direction, seen.inverse_length, sh_basis_backward<Degree>(seen.direction, g_basis));
}

inline Vec3<Float8> see_sites_backward(const float* const (&sites)[kGroup], int count, const SeenColors& seen,
                                       const Float4 (&gradient)[kGroup], float* const (&g_sites)[kGroup]) {
    Vec3<Float8> g_direction = {};
    for (int lane = 0; lane < count; ++lane) {
        Float4 g = unclamped_gradient(seen.color[lane], gradient[lane]);
        float weights[kSites];
        for (int k = 0; k < kSites; ++k) weights[k] = seen.basis[k][lane];
        Vec3<float> own = site_weights_backward<4>(sites[lane], lane_of(seen.direction, lane), weights,
                                                   {g[0], g[1], g[2]}, g_sites[lane]);
        g_direction.x[lane] = own.x, g_direction.y[lane] = own.y, g_direction.z[lane] = own.z;
    }
    return normalize_backward(seen.direction, seen.inverse_length, g_direction);
}

// From dL/dcolor, adds dL/dsh to each lane's g_sh, rows of four [K][4], which so never overlap; returns dL/dv, 0 in
// lanes from `count` on.
inline Vec3<Float8> see_colors_backward(const Gaussians& g, const float* const (&sh)[kGroup], int count,
                                        const SeenColors& seen, const Float4 (&gradient)[kGroup],
                                        float* const (&g_sh)[kGroup]) {
    if (g.has_sites) return see_sites_backward(sh, count, seen, gradient, g_sh);
    return with_degree(g.sh_coefficients,
                       [&](auto degree) { return see_colors_backward<degree>(sh, count, seen, gradient, g_sh); });
}

}  // namespace envgs
