// One tile's primitives, front to back, for the tile's 256 pixels: the loop of the forward and the backward pass.
//
// A warp owns 8×4 pixels. The block fetches 256 primitives at a time and notes which of its eight warps each may touch,
// so that a warp spends no time on primitives that pass it by.
#pragma once
#include "raster.cuh"

namespace envgs {

constexpr int kBatch = 256;

struct Pixel {
    int x, y;
    long at;  // in a plane
    bool inside;
};

ENVGS_FN Pixel own_pixel(const PinholeCamera& camera, int tile, int tiles_x) {
    Pixel p;
    p.x = tile % tiles_x * kTile + (warp_id() & 1) * 8 + (lane_id() & 7);
    p.y = tile / tiles_x * kTile + (warp_id() >> 1) * 4 + (lane_id() >> 3);
    p.at = long(p.y) * camera.width + p.x;
    p.inside = p.x < camera.width && p.y < camera.height;
    return p;
}

// Bit w: whether warp w's pixels may be touched.
ENVGS_FN u32 touched_warps(const Outline& outline, int x0, int y0) {
    u32 warps = 0;
#pragma unroll
    for (int strip = 0; strip < 4; ++strip) {
        Columns c = columns_in(outline, y0 + 4 * strip, y0 + 4 * strip + 3);
        if (c.first > c.last) continue;
        if (c.first < x0 + 8 && c.last >= x0) warps |= 1u << 2 * strip;
        if (c.first < x0 + 16 && c.last >= x0 + 8) warps |= 2u << 2 * strip;
    }
    return warps;
}

// Calls visit(primitive, slot) for each primitive that may touch the warp, all lanes together, until every pixel of the
// block is done; `live` is this thread's, and visit() may end it.
template <class Visit>
ENVGS_FN void for_each_primitive(uint2 range, const u32* instance_slots, const VisiblePrimitive* primitives,
                                 const Outline* outlines, int x0,
                        int y0, const bool& live, const Visit& visit) {
    __shared__ VisiblePrimitive batch[kBatch];
    __shared__ u32 batch_slots[kBatch];
    __shared__ unsigned char batch_warps[kBatch];
    for (u32 begin = range.x; begin < range.y; begin += kBatch) {
        if (!__syncthreads_or(live)) break;
        u32 at = begin + threadIdx.x;
        batch_warps[threadIdx.x] = 0;
        if (at < range.y) {
            u32 slot = instance_slots[at];
            batch[threadIdx.x] = primitives[slot];
            batch_slots[threadIdx.x] = slot;
            batch_warps[threadIdx.x] = touched_warps(outlines[slot], x0, y0);
        }
        __syncthreads();
        u32 here = min(u32(kBatch), range.y - begin);
        for (u32 group = 0; group < here && __any_sync(kFullWarp, live); group += 32) {
            u32 mine = __ballot_sync(kFullWarp, batch_warps[group + lane_id()] >> warp_id() & 1);
            for (; mine; mine &= mine - 1) {
                u32 k = group + __ffs(mine) - 1;
                visit(batch[k], batch_slots[k]);
            }
        }
    }
}

}  // namespace envgs
