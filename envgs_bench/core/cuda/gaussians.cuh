// What a thread reads of a GaussianSet. SH_COEFFICIENTS, HAS_SITES and EXTRAS are fixed when a module is compiled, so
// that a primitive's values stay in registers.
#pragma once
#include "kernels/gaussian_3d_splat.h"
#include "kernels/planes.h"
#include "kernels/sites.h"
#include "kernels/surfel_splat.h"

namespace envgs {

constexpr int kShFloats = 3 * SH_COEFFICIENTS;
constexpr int kShDegree = SH_COEFFICIENTS == 1 ? 0 : SH_COEFFICIENTS == 4 ? 1 : SH_COEFFICIENTS == 9 ? 2 : 3;
constexpr bool kHasSites = HAS_SITES;
static_assert(!kHasSites || kShFloats == kSites * kSiteFloats);
constexpr int kExtras = EXTRAS;

// Whether color and alpha are drawn alone, for pictures that nobody differentiates.
constexpr bool kColorAlone = COLOR_ALONE;
static_assert(!kColorAlone || kExtras == 0);

__host__ __device__ constexpr int padded(int floats) { return (floats + 3) / 4 * 4; }

struct Gaussians {
    const float *means, *quaternions, *scales, *opacities, *sh, *extras;
    int count;
};

ENVGS_FN Quaternion<float> quaternion_at(const Gaussians& g, int i) {
    float4 q = reinterpret_cast<const float4*>(g.quaternions)[i];
    return {q.x, q.y, q.z, q.w};
}
ENVGS_FN Vec3<float> mean_at(const Gaussians& g, int i) { return load3(g.means + 3l * i); }

// The color seen along v = mean − origin.
ENVGS_FN Vec3<float> seen_color(const float* sh, Vec3<float> v) {
    if constexpr (kHasSites)
        return site_color(sh, v);
    else
        return sh_color<kShDegree>(sh, v);
}

// Adds dL/dsh to g_sh and returns dL/dv; `color` is what seen_color returned.
ENVGS_FN Vec3<float> seen_color_backward(const float* sh, Vec3<float> v, Vec3<float> color, Vec3<float> g,
                                         float* g_sh) {
    if constexpr (kHasSites)
        return site_color_backward(sh, v, color, g, g_sh);
    else
        return sh_color_backward<kShDegree>(sh, v, color, g, g_sh);
}

// A pixel or ray as it grows from front to back.
struct BlendedPixel {
    BlendedSums<float> sums;
    float transmittance;
    int hits;
    float extras[kExtras + 1];

    ENVGS_FN static BlendedPixel initial() {
        BlendedPixel pixel = {};
        pixel.transmittance = 1.0f;
        return pixel;
    }

    ENVGS_FN void add(float weight, Vec3<float> color, float t, float side, Vec3<float> normal, const float* e) {
        blend(sums, weight, color, t, side, normal);
#pragma unroll
        for (int k = 0; k < kExtras; ++k) extras[k] += weight * e[k];
        ++hits;
    }
    // Adds what the same pixel blended elsewhere; the transmittance stays.
    ENVGS_FN void join(const BlendedPixel& other) {
        sums.color = sums.color + other.sums.color;
        sums.normal = sums.normal + other.sums.normal;
        sums.depth += other.sums.depth;
#pragma unroll
        for (int k = 0; k < kExtras; ++k) extras[k] += other.extras[k];
        hits += other.hits;
    }
    ENVGS_FN void store(const Planes<float>& out, int* hit_counts, long at, Vec3<float> background) const {
        if constexpr (kColorAlone) {
            write_color(out, at, sums.color, transmittance, background);
            return;
        }
        write_blended(out, at, sums, transmittance, background);
#pragma unroll
        for (int k = 0; k < kExtras; ++k) out.extras[k * out.pixels + at] = extras[k];
        hit_counts[at] = hits;
    }
};

// What reaches a pixel or ray from the loss, and its state as the backward pass goes front to back: see blend.h.
struct UpstreamGradient {
    SumGradient<float> sum;
    float extras[kExtras + 1];
    float transmittance, remaining;

    UpstreamGradient() = default;
    ENVGS_FN UpstreamGradient(const Planes<const float>& out, const Planes<const float>& gradient, long at,
                              Vec3<float> background)
        : transmittance(1.0f) {
        PixelGradient pixel = read_gradient(out, gradient, at, background);
        sum = pixel.sum, remaining = pixel.total;
#pragma unroll
        for (int k = 0; k < kExtras; ++k) {
            extras[k] = read(gradient.extras, k * out.pixels + at);
            remaining += extras[k] * out.extras[k * out.pixels + at];
        }
    }
    ENVGS_FN float value(Vec3<float> color, float t, float side, Vec3<float> normal, const float* e) const {
        float value = hit_value(sum, color, t, side, normal);
#pragma unroll
        for (int k = 0; k < kExtras; ++k) value += extras[k] * e[k];
        return value;
    }
    ENVGS_FN HitGradient<float> hit(float alpha, Vec3<float> color, float t, float side, Vec3<float> normal,
                                    const float* e) {
        return blend_backward(alpha, value(color, t, side, normal, e), transmittance, remaining);
    }
};

}  // namespace envgs
