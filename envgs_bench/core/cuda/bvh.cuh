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
    float opacity;  // 0 where never visible
    int index;      // in the set; −1: none
};

// Surfels by slot, their place in the BVH. A leaf keeps the first 16 bytes of all its surfels, then the next: threads
// that read a surfel each of one leaf read side by side. What is left out takes fewer instructions to compute than to
// read: v, which is n × u times s_u/s_v, and the support. The normal is kept, or surfels in one plane would not all be
// hit at the same t.
struct PackedSurfels {
    static_assert(3 * sizeof(float4) == 4 * SURFEL_FLOATS, "store() writes three float4s a surfel");
    float4* packed;

    ENVGS_FN float4* first(u32 slot) const { return packed + (slot / kLeaf * (3 * kLeaf) + slot % kLeaf); }

    __device__ __forceinline__ TracedSurfel load(u32 slot) const {
        const float4* at = first(slot);
        float4 a = at[0], b = at[kLeaf], c = at[2 * kLeaf];
        Vec3<float> n = {a.x, a.y, a.z}, u = {b.x, b.y, b.z};
        return {{u, a.w * cross(n, u), n}, {c.x, c.y, c.z}, b.w, __float_as_int(c.w)};
    }
    __device__ __forceinline__ void store(u32 slot, const TracedSurfel& s, float scale_u_over_v) const {
        float4* at = first(slot);
        Vec3<float> n = s.frame.n, u = s.frame.u;
        at[0] = make_float4(n.x, n.y, n.z, scale_u_over_v), at[kLeaf] = make_float4(u.x, u.y, u.z, s.opacity);
        at[2 * kLeaf] = make_float4(s.mean.x, s.mean.y, s.mean.z, __int_as_float(s.index));
    }
    __device__ __forceinline__ int index(u32 slot) const { return __float_as_int(first(slot)[2 * kLeaf].w); }
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
