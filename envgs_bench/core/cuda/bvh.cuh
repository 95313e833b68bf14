// The BVH: surfels along a Hilbert curve through their centers, 4 to a leaf, and 32 boxes to a node. Children follow
// from positions, so there are no pointers to build; a warp tests a node's 32 boxes at once, a thread each, from three
// coalesced loads.
#pragma once
#include "gaussians.cuh"
#include "warp.cuh"

namespace envgs {

constexpr int kLeaf = LEAF_SURFELS;
constexpr int kMaxLevels = 5;  // enough for 2²⁴ surfels

struct TracedSurfel {
    SurfelFrame<float> frame;
    Vec3<float> mean;
    float support, opacity;  // support < 0 where never visible
    int index;               // in the set; −1: none
};

// Surfels by slot, their place in the BVH. A leaf keeps the first 16 bytes of all its surfels, then the next: threads
// that read a surfel each of one leaf read side by side.
struct PackedSurfels {
    static_assert(4 * sizeof(float4) == 4 * SURFEL_FLOATS, "store() writes four float4s a surfel");
    float4* packed;

    ENVGS_FN float4* first(u32 slot) const { return packed + (slot / kLeaf * (4 * kLeaf) + slot % kLeaf); }

    __device__ __forceinline__ TracedSurfel load(u32 slot) const {
        const float4* at = first(slot);
        float4 a = at[0], b = at[kLeaf], c = at[2 * kLeaf], d = at[3 * kLeaf];
        return {{{a.x, a.y, a.z}, {a.w, b.x, b.y}, {b.z, b.w, c.x}}, {c.y, c.z, c.w}, d.x, d.y, __float_as_int(d.z)};
    }
    __device__ __forceinline__ void store(u32 slot, const TracedSurfel& s) const {
        float4* at = first(slot);
        const SurfelFrame<float>& f = s.frame;
        at[0] = make_float4(f.u.x, f.u.y, f.u.z, f.v.x), at[kLeaf] = make_float4(f.v.y, f.v.z, f.n.x, f.n.y);
        at[2 * kLeaf] = make_float4(f.n.z, s.mean.x, s.mean.y, s.mean.z);
        at[3 * kLeaf] = make_float4(s.support, s.opacity, __int_as_float(s.index), 0.0f);
    }
    __device__ __forceinline__ int index(u32 slot) const { return __float_as_int(first(slot)[3 * kLeaf].z); }
};

// Level 0 holds a box a leaf, level l + 1 a box for 32 of level l; each level is padded to whole groups of 32 with
// empty boxes, and the last is one group. A plane of (low, high) pairs for each axis.
struct Levels {
    int offset[kMaxLevels + 1];  // where each level begins in a plane; the last is the planes' length
    int count;

    __device__ static Levels of(int surfels) {
        Levels levels;
        levels.count = 0;
        int size = max((surfels + 32 * kLeaf - 1) / (32 * kLeaf), 1), at = 0;
        for (;;) {
            levels.offset[levels.count++] = at;
            at += size * 32;
            if (size == 1) break;
            size = (size + 31) / 32;
        }
        levels.offset[levels.count] = at;
        return levels;
    }
    __device__ int total() const { return offset[count]; }
};

// Where the centers are: least, largest, sum and sum of squares of each axis, how many; the extremes as sortable bits.
struct CenterStatistics {
    u32 low[3], high[3];
    float sum[3], squares[3];
    float count;
};
static_assert(sizeof(CenterStatistics) == 4 * CENTER_STATISTIC_INTS);

// The box that positions are quantized in: three standard deviations about the centers' mean, so that a few stray
// primitives do not take the curve's resolution from all others.
struct Extent {
    Vec3<float> low, size;

    ENVGS_FN explicit Extent(const CenterStatistics& s) {
        float l[3], h[3];
        for (int k = 0; k < 3; ++k) {
            float n = maximum(s.count, 1.0f), mean = s.sum[k] / n;
            float deviation = square_root(maximum(s.squares[k] / n - mean * mean, 0.0f));
            l[k] = maximum(from_sortable_bits(s.low[k]), mean - 3.0f * deviation);
            h[k] = minimum(from_sortable_bits(s.high[k]), mean + 3.0f * deviation);
        }
        low = {l[0], l[1], l[2]};
        size = {maximum(h[0] - l[0], 1e-20f), maximum(h[1] - l[1], 1e-20f), maximum(h[2] - l[2], 1e-20f)};
    }
    // `point` as whole numbers below 2^bits, clamped.
    ENVGS_FN void quantize(Vec3<float> point, int bits, u32 (&cell)[3]) const {
        float cells = float(1 << bits);
        Vec3<float> p = point - low;
        cell[0] = u32(minimum(maximum(p.x / size.x * cells, 0.0f), cells - 1.0f));
        cell[1] = u32(minimum(maximum(p.y / size.y * cells, 0.0f), cells - 1.0f));
        cell[2] = u32(minimum(maximum(p.z / size.z * cells, 0.0f), cells - 1.0f));
    }
};

// Position along a Hilbert curve of 2^(3·bits) cells (Skilling 2004).
ENVGS_FN u32 hilbert_position(u32 (&x)[3], int bits) {
    u32 top = 1u << (bits - 1);
    for (u32 q = top; q > 1; q >>= 1) {
        u32 p = q - 1;
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            if (x[k] & q) {
                x[0] ^= p;
            } else {
                u32 t = (x[0] ^ x[k]) & p;
                x[0] ^= t;
                x[k] ^= t;
            }
        }
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    u32 t = 0;
    for (u32 q = top; q > 1; q >>= 1)
        if (x[2] & q) t ^= q - 1;
    u32 position = 0;
    for (int bit = bits - 1; bit >= 0; --bit)
#pragma unroll
        for (int k = 0; k < 3; ++k) position = position << 1 | ((x[k] ^ t) >> bit & 1);
    return position;
}

}  // namespace envgs
