// The tracer's data that several kernels share.
#pragma once
#include "bvh.cuh"
#include "half.cuh"

namespace envgs {

// SH coefficients and extras of a surfel, packed for 16-byte loads, in the BVH's order: floats, and for color alone
// pairs of halves.
constexpr int kAppearance = APPEARANCE_FLOATS;
static_assert(kAppearance == padded(kColorAlone ? (kShFloats + 1) / 2 : kShFloats + kExtras));

struct PackedAppearance {
    float4 words4[kAppearance / 4];
};

struct Appearance {
    float sh[2 * kAppearance], extras[kExtras + 1];

    __device__ __forceinline__ explicit Appearance(const PackedAppearance& packed) {
#pragma unroll
        for (int k = 0; k < kAppearance / 4; ++k) {
            float4 word4 = packed.words4[k];
            take(4 * k, word4.x), take(4 * k + 1, word4.y), take(4 * k + 2, word4.z), take(4 * k + 3, word4.w);
        }
    }

private:
    __device__ __forceinline__ void take(int k, float word) {
        if constexpr (kColorAlone) {
            float2 pair = floats_of(__float_as_uint(word));
            sh[2 * k] = pair.x, sh[2 * k + 1] = pair.y;
        } else if (k < kShFloats) {
            sh[k] = word;
        } else if (k < kShFloats + kExtras) {
            extras[k - kShFloats] = word;
        }
    }
};

constexpr int kRays = PACKET_RAYS;

// SH at the ray's direction; else from its origin toward each surfel's center. Fixed as SH_COEFFICIENTS is.
constexpr bool kShAlongRay = SH_ALONG_RAY;

// The rays' hits are remembered page by page: a page holds rows of one hit (a slot) for each ray of a packet.
constexpr int kPageRows = PAGE_ROWS;
constexpr u32 kNoHit = ~0u;

struct Pages {
    u32* slots;    // [capacity][kPageRows][kRays]
    int* next;     // [capacity]
    int2* heads;   // [packets] first page, and how many rows follow from there
    u32* used;     // may pass capacity: then hits were lost
    u32 capacity;  // 0: nothing is kept
};

struct Ray {
    Vec3<float> origin, direction;
    int index;  // −1: none
};

// Ray `at` along `order`; packets take rays in that order.
ENVGS_FN Ray ordered_ray(const float* origins, const float* directions, const u32* order, int count, long at) {
    if (at >= count) return {{0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, -1};
    int index = order[at];
    return {load3(origins + 3l * index), load3(directions + 3l * index), index};
}

// What the backward pass adds up for a surfel: a row of floats, by index in the set.
constexpr int kMomentSums = 12, kNormalSum = 12, kOpacitySum = 15, kDirectionSum = 16, kShSums = 19;
constexpr int kTraceSums = TRACE_SUM_FLOATS;
static_assert(sizeof(SurfelMoments<float>) == 4 * kMomentSums);
static_assert(kTraceSums == padded(kShSums + kShFloats + kExtras));

}  // namespace envgs
