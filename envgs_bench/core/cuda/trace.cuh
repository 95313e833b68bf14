// The tracer's data that several kernels share.
#pragma once
#include "bvh.cuh"

namespace envgs {

// SH coefficients and extras of a surfel, packed for 16-byte loads, in the BVH's order.
constexpr int kAppearance = APPEARANCE_FLOATS;
static_assert(kAppearance == padded(kShFloats + kExtras));

struct alignas(16) Appearance {
    float values[kAppearance];
};

constexpr int kRays = PACKET_RAYS;

// SH at the ray's direction; else from its origin toward each surfel's center. Fixed as SH_COEFFICIENTS is.
constexpr bool kShAlongRay = SH_ALONG_RAY;

// The rays' hits are remembered page by page: a page holds rows of one hit (a slot) for each ray of a packet.
constexpr int kPageRows = PAGE_ROWS;
constexpr u32 kNoHit = ~0u;

struct Pages {
    u32* slots;      // [capacity][kPageRows][kRays]
    int* next;       // [capacity]
    int2* heads;     // [packets] first page, and how many rows follow from there
    u32* used;       // may pass capacity: then hits were lost
    u32 capacity;    // 0: nothing is kept
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
