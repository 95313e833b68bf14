// Colors by sites on the sphere (spherical Voronoi, Di Sario et al. 2025): each site has a color, and a direction's
// color is a softmax of how far it points toward each site.
#pragma once
#include "splat.h"

namespace envgs {

constexpr int kSites = SITES;   // of gaussians.py, which refuses another number
constexpr int kSiteFloats = 6;  // a site's row: its color, and its direction × how sharply its cell ends

ENVGS_FN Vec3<float> site_vector(const float* sites, int k) { return load3(sites + kSiteFloats * k + 3); }

// weights[k] = softmax over k of s_k·d, d unit or zero.
ENVGS_FN void site_weights(const float* sites, Vec3<float> d, float* weights) {
    float largest = -kInfinity, total = 0.0f;
    for (int k = 0; k < kSites; ++k) {
        weights[k] = dot(site_vector(sites, k), d);
        largest = maximum(largest, weights[k]);
    }
    for (int k = 0; k < kSites; ++k) {
        weights[k] = exponential(weights[k] - largest);
        total += weights[k];
    }
    for (int k = 0; k < kSites; ++k) weights[k] = weights[k] / total;
}

// The color of sites seen along v = mean − origin. `sites` is [kSites][kSiteFloats].
ENVGS_FN Vec3<float> site_color(const float* sites, Vec3<float> v) {
    float weights[kSites];
    site_weights(sites, inverse_length(v) * v, weights);
    Vec3<float> c = {0.0f, 0.0f, 0.0f};
    for (int k = 0; k < kSites; ++k) c = c + weights[k] * load3(sites + kSiteFloats * k);
    return clamped_color(c);
}

// From g = dL/dcolor, adds dL/dsites to g_sites, two rows of `Row` floats a site; returns dL/dd, as if d were free.
template <int Row>
ENVGS_FN Vec3<float> site_weights_backward(const float* sites, Vec3<float> d, const float* weights, Vec3<float> g,
                                           float* g_sites) {
    float mean = 0.0f;
    Vec3<float> g_d = {0.0f, 0.0f, 0.0f};
    for (int k = 0; k < kSites; ++k) mean += weights[k] * dot(g, load3(sites + kSiteFloats * k));
    for (int k = 0; k < kSites; ++k) {
        float g_logit = weights[k] * (dot(g, load3(sites + kSiteFloats * k)) - mean);
        g_d = g_d + g_logit * site_vector(sites, k);
        float *g_color = g_sites + 2 * Row * k, *g_vector = g_color + Row;
        store3(g_color, load3(g_color) + weights[k] * g);
        store3(g_vector, load3(g_vector) + g_logit * d);
    }
    return g_d;
}

// Adds dL/dsites to g_sites [kSites][kSiteFloats] and returns dL/dv; `color` is what site_color returned.
ENVGS_FN Vec3<float> site_color_backward(const float* sites, Vec3<float> v, Vec3<float> color, Vec3<float> g,
                                         float* g_sites) {
    float weights[kSites], inverse = inverse_length(v);
    Vec3<float> d = inverse * v;
    g = unclamped_gradient(color, g);
    site_weights(sites, d, weights);
    return normalize_backward(d, inverse, site_weights_backward<3>(sites, d, weights, g, g_sites));
}

}  // namespace envgs
