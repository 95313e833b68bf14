// What a thread reads of a GaussianSet. SH_COEFFICIENTS and EXTRAS are fixed when a module is compiled, so that a
// primitive's values stay in registers.
#pragma once
#include "kernels/gaussian_3d_splat.h"
#include "kernels/surfel_splat.h"

namespace envgs {

constexpr int kShFloats = 3 * SH_COEFFICIENTS;
constexpr int kShDegree = SH_COEFFICIENTS == 1 ? 0 : SH_COEFFICIENTS == 4 ? 1 : SH_COEFFICIENTS == 9 ? 2 : 3;
constexpr int kExtras = EXTRAS;

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

// The planes of an image or a batch of rays, one float a pixel; in gradients a null pointer stands for zeros.
template <class T>
struct Planes {
    T *color, *alpha, *depth, *normal, *extras;
    long pixels;
};

ENVGS_FN float read(const float* plane, long at) { return plane ? plane[at] : 0.0f; }
ENVGS_FN Vec3<float> read3(const float* planes, long at, long pixels) {
    if (!planes) return {0.0f, 0.0f, 0.0f};
    return {planes[at], planes[pixels + at], planes[2 * pixels + at]};
}
ENVGS_FN void write3(float* planes, long at, long pixels, Vec3<float> v) {
    planes[at] = v.x, planes[pixels + at] = v.y, planes[2 * pixels + at] = v.z;
}

// The sums of a pixel or ray as they grow from front to back.
struct BlendedSums {
    Vec3<float> color, normal;
    float depth, transmittance;
    int hits;
    float extras[kExtras + 1];

    ENVGS_FN static BlendedSums initial() {
        BlendedSums sums = {};
        sums.transmittance = 1.0f;
        return sums;
    }

    ENVGS_FN void add(float weight, Vec3<float> c, float t, Vec3<float> facing_normal, const float* e) {
        color = color + weight * c;
        normal = normal + weight * facing_normal;
        depth += weight * t;
#pragma unroll
        for (int k = 0; k < kExtras; ++k) extras[k] += weight * e[k];
        ++hits;
    }
    ENVGS_FN void store(const Planes<float>& out, int* hit_counts, long at, Vec3<float> background) const {
        float alpha = 1.0f - transmittance;
        write3(out.color, at, out.pixels, color + transmittance * background);
        write3(out.normal, at, out.pixels, normal);
        out.alpha[at] = alpha;
        out.depth[at] = alpha > 0.0f ? depth / alpha : 0.0f;
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

    ENVGS_FN UpstreamGradient(const Planes<const float>& out, const Planes<const float>& gradient, long at,
                      Vec3<float> background)
        : transmittance(1.0f) {
        float alpha = out.alpha[at], depth = out.depth[at];
        sum = sum_gradient(read3(gradient.color, at, out.pixels), read(gradient.alpha, at), read(gradient.depth, at),
                           read3(gradient.normal, at, out.pixels), alpha, depth, background);
        remaining = blended_total(sum, read3(out.color, at, out.pixels), alpha, depth, read3(out.normal, at,
                                                                                             out.pixels),
                             background);
#pragma unroll
        for (int k = 0; k < kExtras; ++k) {
            extras[k] = gradient.extras ? gradient.extras[k * out.pixels + at] : 0.0f;
            remaining += extras[k] * out.extras[k * out.pixels + at];
        }
    }
    // g·c of a hit: what a unit of its weight changes the loss by.
    ENVGS_FN float value(Vec3<float> color, float t, Vec3<float> facing_normal, const float* e) const {
        float v = dot(sum.color, color) + sum.depth * t + dot(sum.normal, facing_normal) + sum.weight;
#pragma unroll
        for (int k = 0; k < kExtras; ++k) v += extras[k] * e[k];
        return v;
    }
};

}  // namespace envgs
