// Where blended sums go and gradients come from: one plane a channel over P pixels or rays.
#pragma once
#include "blend.h"

namespace envgs {

// color [3][P], alpha [P], depth [P], normal [3][P], extras [E][P]. In gradients a null pointer stands for zeros.
template <class T>
struct Planes {
    T *color, *alpha, *depth, *normal, *extras;
    long pixels;  // P
};

ENVGS_FN float read(const float* plane, long at) { return plane ? plane[at] : 0.0f; }
ENVGS_FN Vec3<float> read3(const float* planes, long at, long pixels) {
    if (!planes) return {0.0f, 0.0f, 0.0f};
    return {planes[at], planes[pixels + at], planes[2 * pixels + at]};
}
ENVGS_FN void write3(float* planes, long at, long pixels, Vec3<float> v) {
    planes[at] = v.x, planes[pixels + at] = v.y, planes[2 * pixels + at] = v.z;
}

// Writes the color and alpha that a pixel has once its last hit is blended.
ENVGS_FN void write_color(const Planes<float>& out, long at, Vec3<float> color, float transmittance,
                          Vec3<float> background) {
    write3(out.color, at, out.pixels, color + transmittance * background);
    out.alpha[at] = 1.0f - transmittance;
}

// And all else, but for the extras.
ENVGS_FN void write_blended(const Planes<float>& out, long at, const BlendedSums<float>& sums, float transmittance,
                            Vec3<float> background) {
    float alpha = 1.0f - transmittance;
    write_color(out, at, sums.color, transmittance, background);
    write3(out.normal, at, out.pixels, sums.normal);
    out.depth[at] = alpha > 0.0f ? sums.depth / alpha : 0.0f;
}

// What reaches a pixel from the loss, from the planes that it was drawn to, but for the extras; and the pixel's S.
struct PixelGradient {
    SumGradient<float> sum;
    float total;
};

ENVGS_FN PixelGradient read_gradient(const Planes<const float>& out, const Planes<const float>& gradient, long at,
                                     Vec3<float> background) {
    float alpha = out.alpha[at], depth = out.depth[at];
    SumGradient<float> g =
        sum_gradient(read3(gradient.color, at, out.pixels), read(gradient.alpha, at), read(gradient.depth, at),
                     read3(gradient.normal, at, out.pixels), alpha, depth, background);
    return {g, blended_total(g, read3(out.color, at, out.pixels), alpha, depth, read3(out.normal, at, out.pixels),
                             background)};
}

}  // namespace envgs
