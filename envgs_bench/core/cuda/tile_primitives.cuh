// One tile's primitives, front to back, for the tile's 256 pixels: the loop of the forward and the backward pass.
//
// A tile has eight areas of 8×4 pixels. Where an image has tiles enough to fill the GPU (TILE_BLOCKS 1), a block takes a
// tile and a warp an area: the block fetches 256 primitives at a time and notes which areas each may touch, so that a
// warp spends no time on primitives that pass it by.
//
// In a small image few warps would each walk a long list, a primitive after the other. There (TILE_BLOCKS 8) a block
// takes an area, and its eight warps share the list: of those of 256 primitives that touch the area, each takes an
// eighth. All find first how much light their eighth lets through; what lies before it then gives each the state that
// it has to begin with, and they visit their primitives side by side.
#pragma once
#include "raster.cuh"

namespace envgs {

constexpr int kBatch = 256;
constexpr int kAreas = TILE_AREAS;  // of a tile, as many as a block has warps
constexpr bool kSharedArea = TILE_BLOCKS == kAreas;
static_assert(TILE_BLOCKS == 1 || kSharedArea);

// Where a thread draws: a block's tile, and the area of that tile.
struct Place {
    int tile, area;
    ENVGS_FN static Place own() {
        return {int(blockIdx.x) / TILE_BLOCKS, kSharedArea ? int(blockIdx.x) % TILE_BLOCKS : warp_id()};
    }
};

struct Pixel {
    int x, y;
    long at;  // in a plane
    bool inside;
};

ENVGS_FN Pixel own_pixel(const PinholeCamera& camera, Place place, int tiles_x) {
    Pixel p;
    p.x = place.tile % tiles_x * kTile + (place.area & 1) * 8 + (lane_id() & 7);
    p.y = place.tile / tiles_x * kTile + (place.area >> 1) * 4 + (lane_id() >> 3);
    p.at = long(p.y) * camera.width + p.x;
    p.inside = p.x < camera.width && p.y < camera.height;
    return p;
}

// Bit a: whether pixels of area a may be touched.
ENVGS_FN u32 touched_areas(const Outline& outline, int x0, int y0) {
    u32 areas = 0;
#pragma unroll
    for (int strip = 0; strip < 4; ++strip) {
        Columns c = columns_in(outline, y0 + 4 * strip, y0 + 4 * strip + 3);
        if (c.first > c.last) continue;
        if (c.first < x0 + 8 && c.last >= x0) areas |= 1u << 2 * strip;
        if (c.first < x0 + 16 && c.last >= x0 + 8) areas |= 2u << 2 * strip;
    }
    return areas;
}

// What a pixel has become on its way through the list.
struct Progress {
    float transmittance;
    float remaining;  // what the backward pass has left of S, see blend.h; unused in the forward pass
};

// A tile's list, and what is needed to walk it.
struct TileList {
    uint2 range;
    const u32* instance_slots;
    const VisiblePrimitive* primitives;
    const Outline* outlines;
    int x0, y0;  // the tile's first pixel

    ENVGS_FN TileList(const uint2* ranges, const u32* slots, const VisiblePrimitive* all, const Outline* outlines,
                      int tile, int tiles_x)
        : range(ranges[tile]), instance_slots(slots), primitives(all), outlines(outlines),
          x0(tile % tiles_x * kTile), y0(tile / tiles_x * kTile) {}

    // Calls visit(primitive, slot) for each primitive that may touch the warp's area, all lanes together, until every
    // pixel of the block is done; `live` is this thread's, and visit() may end it.
    template <class Visit>
    ENVGS_FN void walk(const bool& live, const Visit& visit) const {
        __shared__ VisiblePrimitive batch[kBatch];
        __shared__ u32 batch_slots[kBatch];
        __shared__ unsigned char batch_areas[kBatch];
        for (u32 begin = range.x; begin < range.y; begin += kBatch) {
            if (!__syncthreads_or(live)) break;
            u32 at = begin + threadIdx.x;
            batch_areas[threadIdx.x] = 0;
            if (at < range.y) {
                u32 slot = instance_slots[at];
                batch[threadIdx.x] = primitives[slot];
                batch_slots[threadIdx.x] = slot;
                batch_areas[threadIdx.x] = touched_areas(outlines[slot], x0, y0);
            }
            __syncthreads();
            u32 here = min(u32(kBatch), range.y - begin);
            for (u32 group = 0; group < here && __any_sync(kFullWarp, live); group += 32) {
                u32 mine = __ballot_sync(kFullWarp, batch_areas[group + lane_id()] >> warp_id() & 1);
                for (; mine; mine &= mine - 1) {
                    u32 k = group + __ffs(mine) - 1;
                    visit(batch[k], batch_slots[k]);
                }
            }
        }
    }

    // The same with the block's warps sharing the area. `progress` is the pixel's, the same in all warps; it is finished
    // below `transmittance_min`. For each primitive of its eighth, a warp first calls survey(primitive, progress), which
    // advances a progress that began with {1, 0}; then begin(progress), visit(primitive, slot) for each as above, and
    // end(finished): whether the pixel ended in this eighth. All three see the pixel as the eighths before left it.
    template <class Survey, class Begin, class Visit, class End>
    ENVGS_FN void share(int area, float transmittance_min, Progress& progress, const Survey& survey,
                        const Begin& begin, const bool& live, const Visit& visit, const End& end) const {
        __shared__ VisiblePrimitive batch[kBatch];
        __shared__ u32 batch_slots[kBatch];
        __shared__ u32 counts[kAreas];
        __shared__ Progress passed[kAreas][32];
        for (u32 first = range.x; first < range.y; first += kBatch) {
            if (!__syncthreads_or(progress.transmittance >= transmittance_min)) break;
            u32 at = first + threadIdx.x, slot = at < range.y ? instance_slots[at] : 0;
            bool touches = at < range.y && touched_areas(outlines[slot], x0, y0) >> area & 1;
            u32 those = __ballot_sync(kFullWarp, touches);
            if (lane_id() == 0) counts[warp_id()] = __popc(those);
            __syncthreads();
            u32 place = __popc(those & ((1u << lane_id()) - 1)), count = 0;
            for (int warp = 0; warp < kAreas; ++warp) {
                if (warp == warp_id()) place += count;
                count += counts[warp];
            }
            if (touches) batch[place] = primitives[slot], batch_slots[place] = slot;
            __syncthreads();

            u32 each = (count + kAreas - 1) / kAreas, mine = min(count, each * warp_id()), last = min(count, mine + each);
            Progress own = {1.0f, 0.0f};
            for (u32 k = mine; k < last; ++k) survey(batch[k], own);
            passed[warp_id()][lane_id()] = own;
            __syncthreads();
            Progress before = progress;
            for (int warp = 0; warp < kAreas; ++warp) {
                Progress through = passed[warp][lane_id()];
                if (warp == warp_id()) before = progress;
                progress.remaining -= progress.transmittance * through.remaining;
                progress.transmittance *= through.transmittance;
            }
            begin(before);
            for (u32 k = mine; k < last && __any_sync(kFullWarp, live); ++k) visit(batch[k], batch_slots[k]);
            end(before.transmittance >= transmittance_min &&
                before.transmittance * own.transmittance < transmittance_min);
        }
    }
};

}  // namespace envgs
