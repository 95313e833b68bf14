// Front-to-back blending and its derivative.
//
// A hit of value c and opacity α adds w = T·α times c and leaves the transmittance T·(1 − α). Every output of a pixel
// is a sum Σ wᵢcᵢ (alpha itself with cᵢ = 1), so the pixel's loss reaches a hit through one number, g·cᵢ. With
// S = Σ wᵢ(g·cᵢ) over the whole pixel, known from the forward pass, the backward pass goes front to back too:
//     dL/dαᵢ = Tᵢ(g·cᵢ) − (S − Σ_{j≤i} wⱼ(g·cⱼ)) / (1 − αᵢ).
#pragma once
#include "vec3.h"

namespace envgs {

// What a pixel or ray sums over its hits: Σ wᵢcᵢ, besides the extras, whose number differs.
template <class R>
struct BlendedSums {
    Vec3<R> color, normal;
    R depth;
};

// Adds a hit of the given weight. What many pixels share may stay one float (C); side: +1 where the ray hits the front.
template <class R, class C>
ENVGS_FN void blend(BlendedSums<R>& sums, R weight, Vec3<C> color, R t, R side, Vec3<C> normal) {
    sums.color = {sums.color.x + weight * color.x, sums.color.y + weight * color.y, sums.color.z + weight * color.z};
    R facing = side * weight;
    sums.normal = {sums.normal.x + facing * normal.x, sums.normal.y + facing * normal.y,
                   sums.normal.z + facing * normal.z};
    sums.depth = sums.depth + weight * t;
}

template <class R>
ENVGS_FN R response_alpha(R opacity, R rho) {
    return minimum(broadcast<R>(kMaxAlpha), opacity * exponential(-0.5f * rho));
}

// dL/dopacity and dL/dρ from dL/dα; both vanish where α is clamped.
template <class R>
struct AlphaGradient {
    R opacity, rho;
};

template <class R>
ENVGS_FN AlphaGradient<R> alpha_backward(R opacity, R alpha, R g_alpha) {
    R g = select(alpha < kMaxAlpha, g_alpha, broadcast<R>(0.0f));
    return {g * alpha / opacity, -0.5f * alpha * g};
}

// (ΔL)² of a hit that is left out: the pixel's sums are affine in α, so that L, linear in them, changes by −α·dL/dα
// exactly, also where α is clamped.
template <class R>
ENVGS_FN R removal_square(R alpha, R g_alpha) {
    return (alpha * g_alpha) * (alpha * g_alpha);
}

// How a pixel's loss depends on its sums Σ wᵢcᵢ, one entry a channel. Autograd's gradients are
// those of the outputs, which differ from the plain sums by the background and by the division of depth by alpha.
template <class R>
struct SumGradient {
    Vec3<R> color;
    R depth;  // dL/d(Σ wᵢtᵢ)
    Vec3<R> normal;
    R weight;  // dL/d(Σ wᵢ)
};

template <class R>
ENVGS_FN SumGradient<R> sum_gradient(Vec3<R> g_color, R g_alpha, R g_depth, Vec3<R> g_normal, R alpha, R depth,
                                     Vec3<R> background) {
    R inverse = select(alpha > 0.0f, 1.0f / alpha, broadcast<R>(0.0f));
    R g_sum = g_depth * inverse;
    return {g_color, g_sum, g_normal, g_alpha - dot(g_color, background) - g_sum * depth};
}

// The pixel's S (the caller adds the extras' part), from the outputs with background and division undone.
template <class R>
ENVGS_FN R blended_total(SumGradient<R> g, Vec3<R> color, R alpha, R depth, Vec3<R> normal, Vec3<R> background) {
    Vec3<R> blended = color - (1.0f - alpha) * background;
    return dot(g.color, blended) + g.depth * depth * alpha + dot(g.normal, normal) + g.weight * alpha;
}

// g·c of a hit, what a unit of its weight changes the loss by (the caller adds the extras' part); arguments as
// blend()'s.
template <class R, class C>
ENVGS_FN R hit_value(const SumGradient<R>& g, Vec3<C> color, R t, R side, Vec3<C> normal) {
    R along = g.normal.x * normal.x + g.normal.y * normal.y + g.normal.z * normal.z;
    return g.color.x * color.x + g.color.y * color.y + g.color.z * color.z + g.depth * t + side * along + g.weight;
}

template <class R>
struct HitGradient {
    R weight;  // of the hit: dL/dc is weight·g
    R alpha;   // dL/dα
};

// One hit, front to back. In: transmittance before the hit, `value` = g·c, `remaining` = S less the hits before.
// Out: both advanced past the hit.
template <class R>
ENVGS_FN HitGradient<R> blend_backward(R alpha, R value, R& transmittance, R& remaining) {
    R weight = transmittance * alpha;
    remaining = remaining - weight * value;
    R g_alpha = transmittance * value - remaining / (1.0f - alpha);
    transmittance = transmittance * (1.0f - alpha);
    return {weight, g_alpha};
}

}  // namespace envgs
