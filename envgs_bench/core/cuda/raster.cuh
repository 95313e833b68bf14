// The rasterizer's data that several kernels share: KIND is SurfelKind or Gaussian3dKind.
#pragma once
#include "gaussians.cuh"
#include "kernels/outline.h"
#include "warp.cuh"

namespace envgs {

constexpr int kTile = TILE;
static_assert(sizeof(Outline) == 4 * OUTLINE_FLOATS);

// What the rasterizer needs to know of surfels.
struct SurfelKind {
    using Splat = SurfelSplat;
    using Response = SurfelPixel<float>;
    using Input = SurfelInput;
    using Sums = SurfelSums<float>;
    static constexpr int scale_count = 2;
    ENVGS_FN static Input input(const Gaussians& g, int i) {
        return {mean_at(g, i), quaternion_at(g, i), g.scales[2l * i], g.scales[2l * i + 1]};
    }
};

// The same for 3D Gaussians.
struct Gaussian3dKind {
    using Splat = Gaussian3dSplat;
    using Response = Gaussian3dPixel<float>;
    using Input = Gaussian3dInput;
    using Sums = Gaussian3dSums<float>;
    static constexpr int scale_count = 3;
    ENVGS_FN static Input input(const Gaussians& g, int i) {
        return {mean_at(g, i), quaternion_at(g, i), load3(g.scales + 3l * i)};
    }
};

using Kind = KIND;

ENVGS_FN int count_tiles(const Outline& o) {
    int count = 0;
    for (int row = o.box.row0 / kTile; row <= o.box.row1 / kTile; ++row) {
        Columns c = tiles_in<kTile>(o, row);
        count += c.last - c.first + 1;
    }
    return count;
}

// What a primitive adds to the pixels that it covers.
template <bool ColorAlone>
struct Look {
    Vec3<float> color, normal;
    float extras[kExtras > 0 ? kExtras : 1];

    ENVGS_FN void take(Vec3<float> own_normal, const float* own_extras) {
        normal = own_normal;
#pragma unroll
        for (int k = 0; k < kExtras; ++k) extras[k] = own_extras[k];
    }
    ENVGS_FN void blend_into(BlendedPixel& pixel, float weight, const Kind::Response& at) const {
        pixel.add(weight, color, at.t, at.side, normal, extras);
    }
};

template <>
struct Look<true> {
    Vec3<float> color;

    ENVGS_FN void take(Vec3<float>, const float*) {}
    ENVGS_FN void blend_into(BlendedPixel& pixel, float weight, const Kind::Response&) const {
        pixel.sums.color = pixel.sums.color + weight * color;
    }
};

// A visible primitive, ready to draw.
struct alignas(16) VisiblePrimitive : Look<kColorAlone> {
    Kind::Splat splat;
};
static_assert(sizeof(VisiblePrimitive) == 4 * VISIBLE_FLOATS);

// What the backward pass adds up for a primitive over its pixels; an array of float to the warp sums.
struct PrimitiveSums {
    Kind::Sums geometry;
    Vec3<float> color, normal;
    float opacity;
    float extras[kExtras + 1];
};
constexpr int kSums = sizeof(PrimitiveSums) / 4 - 1;
constexpr int kSumsStride = PRIMITIVE_SUM_FLOATS;
static_assert(kSums <= kSumsStride && kSumsStride == 32, "one sum a thread of a warp");

// Device-side counters of one image.
struct Counters {
    u32 visible;
    u32 drawn_instances;  // no more than there is room for
    u64 instances;
};
static_assert(sizeof(Counters) == 4 * COUNTER_INTS);

}  // namespace envgs
