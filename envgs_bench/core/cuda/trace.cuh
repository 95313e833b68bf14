// What the tracer's kernels share.
#pragma once
#include "bvh.cuh"

namespace envgs {

// SH coefficients and extras of a surfel, packed for 16-byte loads, in the tree's order.
constexpr int kAppearance = padded(kShFloats + kExtras);

struct alignas(16) Appearance {
    float values[kAppearance];
};

// One ray's hits are remembered page by page: a page holds kPageHits hits of each of a packet's 32 rays.
constexpr int kPageHits = 16;

struct Pages {
    u32* slots;      // [capacity][kPageHits][32]
    int* next;       // [capacity]
    int2* heads;     // [packets] first page, and how many rows of 32 hits follow from there
    u32* used;       // may pass capacity: then hits were lost
    u32 capacity;    // 0: nothing is kept
};

struct Ray {
    Vec3<float> origin, direction;
    int index;  // −1: none
};

// The ray of this thread; packets take rays along `order`.
ENVGS_FN Ray own_ray(const float* origins, const float* directions, const u32* order, int count, int packet) {
    int at = packet * 32 + lane_id();
    if (at >= count) return {{0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, -1};
    int index = order[at];
    return {load3(origins + 3l * index), load3(directions + 3l * index), index};
}

// What the backward pass adds up for a surfel: a row of floats, by index in the set.
constexpr int kMomentSums = 12, kNormalSum = 12, kOpacitySum = 15, kDirectionSum = 16, kShSums = 19;
constexpr int kTraceSums = padded(kShSums + kShFloats + kExtras);

}  // namespace envgs
