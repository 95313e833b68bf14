// One tile's primitives, front to back, for the tile's 256 pixels: the loop of the forward and the backward pass.
//
// A thread has kPixels pixels, four rows apart, so that what a warp does for a primitive is done for all of them. A
// tile has kAreas areas of 8×4·kPixels pixels, a warp's each. Where an image has tiles enough to fill the GPU
// (TILE_BLOCKS 1), a block takes a tile and a warp an area: the block fetches a primitive a thread at a time and notes
// which areas each may touch, so that a warp spends no time on primitives that pass it by.
//
// In a small image few warps would each walk a long list, a primitive after the other. There (TILE_BLOCKS kAreas) a
// block takes an area, and its eight warps share the list: of those of 256 primitives that touch the area, each takes
// an eighth. All find first how much light their eighth lets through; what lies before it then gives each the state
// that it has to begin with, and they visit their primitives side by side.
#pragma once
#include "raster.cuh"

namespace envgs {

constexpr int kPixels = THREAD_PIXELS;  // of a thread
constexpr int kAreaRows = 4 * kPixels;
constexpr int kAreas = 2 * kTile / kAreaRows;  // of a tile, two side by side
constexpr bool kSharedArea = TILE_BLOCKS > 1;
constexpr int kWarps = kSharedArea ? SHARING_WARPS : kAreas;  // of a block
constexpr int kThreads = 32 * kWarps;
constexpr int kBatch = kThreads;
static_assert(TILE_BLOCKS == 1 || TILE_BLOCKS == kAreas);

// Where a warp draws: a block's tile, and the area of that tile.
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

// A thread's pixels, and which of them are not finished.
struct OwnPixels {
    Pixel pixels[kPixels];
    bool lives[kPixels], live;  // each, and whether any is
    float x, y, near;           // the first one's center

    ENVGS_FN OwnPixels(const PinholeCamera& camera, Place place, int tiles_x) : live(false), near(camera.near) {
#pragma unroll
        for (int k = 0; k < kPixels; ++k) {
            Pixel& p = pixels[k];
            p.x = place.tile % tiles_x * kTile + (place.area & 1) * 8 + (lane_id() & 7);
            p.y = place.tile / tiles_x * kTile + (place.area >> 1) * kAreaRows + 4 * k + (lane_id() >> 3);
            p.at = long(p.y) * camera.width + p.x;
            p.inside = p.x < camera.width && p.y < camera.height;
            lives[k] = p.inside;
            live |= p.inside;
        }
        x = pixels[0].x + 0.5f, y = pixels[0].y + 0.5f;
    }

    ENVGS_FN Kind::Response response(const Kind::Splat& splat, int k) const {
        return evaluate(splat, x, y + 4.0f * k, near);
    }
    // Whether any pixel that is not finished is hit, which of them, and the responses of all.
    ENVGS_FN bool hit(const Kind::Splat& splat, Kind::Response (&at)[kPixels], bool (&hits)[kPixels]) const {
        bool any = false;
#pragma unroll
        for (int k = 0; k < kPixels; ++k) {
            at[k] = response(splat, k);
            hits[k] = lives[k] && at[k].rho <= splat.support;
            any |= hits[k];
        }
        return any;
    }
    // Takes note of whether pixel k goes on; of all of them in turn.
    ENVGS_FN void goes_on(int k, bool lives_on) {
        lives[k] = lives_on;
        live = k == 0 ? lives_on : live || lives_on;
    }
};

// Bit a: whether pixels of area a may be touched.
ENVGS_FN u32 touched_areas(const Outline& outline, int x0, int y0) {
    u32 areas = 0;
#pragma unroll
    for (int strip = 0; strip < kAreas / 2; ++strip) {
        Columns c = columns_in(outline, y0 + kAreaRows * strip, y0 + kAreaRows * strip + kAreaRows - 1);
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
    const int* rows;  // [visible] by slot: the row of the primitive's sums; null where that is the slot
    int x0, y0;       // the tile's first pixel

    ENVGS_FN TileList(const uint2* ranges, const u32* slots, const VisiblePrimitive* all, const Outline* outlines,
                      const int* rows, int tile, int tiles_x)
        : range(ranges[tile]),
          instance_slots(slots),
          primitives(all),
          outlines(outlines),
          rows(rows),
          x0(tile % tiles_x * kTile),
          y0(tile / tiles_x * kTile) {}

    ENVGS_FN u32 row_of(u32 slot) const { return rows ? rows[slot] : slot; }

    // Calls visit(primitive, row) for each primitive that may touch the warp's area, all lanes together, until every
    // pixel of the block is done; `live` is this thread's, and visit() may end it.
    template <class Visit>
    ENVGS_FN void walk(const bool& live, const Visit& visit) const {
        __shared__ VisiblePrimitive batch[kBatch];
        __shared__ u32 batch_rows[kBatch];
        __shared__ unsigned char batch_areas[kBatch];
        for (u32 begin = range.x; begin < range.y; begin += kBatch) {
            if (!__syncthreads_or(live)) break;
            u32 at = begin + threadIdx.x;
            batch_areas[threadIdx.x] = 0;
            if (at < range.y) {
                u32 slot = instance_slots[at];
                batch[threadIdx.x] = primitives[slot];
                batch_rows[threadIdx.x] = row_of(slot);
                batch_areas[threadIdx.x] = touched_areas(outlines[slot], x0, y0);
            }
            __syncthreads();
            u32 here = min(u32(kBatch), range.y - begin);
            for (u32 group = 0; group < here && __any_sync(kFullWarp, live); group += 32) {
                u32 mine = __ballot_sync(kFullWarp, batch_areas[group + lane_id()] >> warp_id() & 1);
                for (; mine; mine &= mine - 1) {
                    u32 k = group + __ffs(mine) - 1;
                    visit(batch[k], batch_rows[k]);
                }
            }
        }
    }

    // The same with the block's warps sharing the area. `progress` is that of each of the thread's pixels, the same in
    // all warps; a pixel is finished below `transmittance_min`. For the primitives of its eighth, a warp first calls
    // survey(primitive, progress), which advances what each pixel began with as {1, 0}; then begin(k, progress) for
    // each pixel, visit(primitive, row) for each primitive as above, and end(k, finished) for each pixel: whether it
    // ended in this eighth. All three see the pixels as the eighths before left them.
    template <class Survey, class Begin, class Visit, class End>
    ENVGS_FN void share(int area, float transmittance_min, Progress (&progress)[kPixels], const Survey& survey,
                        const Begin& begin, const bool& live, const Visit& visit, const End& end) const {
        __shared__ VisiblePrimitive batch[kBatch];
        __shared__ u32 batch_rows[kBatch];
        __shared__ u32 counts[kWarps];
        __shared__ Progress passed[kWarps][kPixels][32];
        for (u32 first = range.x; first < range.y; first += kBatch) {
            bool unfinished = false;
#pragma unroll
            for (int k = 0; k < kPixels; ++k) unfinished |= progress[k].transmittance >= transmittance_min;
            if (!__syncthreads_or(unfinished)) break;
            u32 at = first + threadIdx.x, slot = at < range.y ? instance_slots[at] : 0;
            bool touches = at < range.y && touched_areas(outlines[slot], x0, y0) >> area & 1;
            u32 those = __ballot_sync(kFullWarp, touches);
            if (lane_id() == 0) counts[warp_id()] = __popc(those);
            __syncthreads();
            u32 place = __popc(those & ((1u << lane_id()) - 1)), count = 0;
            for (int warp = 0; warp < kWarps; ++warp) {
                if (warp == warp_id()) place += count;
                count += counts[warp];
            }
            if (touches) batch[place] = primitives[slot], batch_rows[place] = row_of(slot);
            __syncthreads();

            u32 each = (count + kWarps - 1) / kWarps, mine = min(count, each * warp_id()),
                last = min(count, mine + each);
            Progress own[kPixels], before[kPixels];
#pragma unroll
            for (int k = 0; k < kPixels; ++k) own[k] = {1.0f, 0.0f};
            for (u32 i = mine; i < last; ++i) survey(batch[i], own);
#pragma unroll
            for (int k = 0; k < kPixels; ++k) passed[warp_id()][k][lane_id()] = own[k];
            __syncthreads();
#pragma unroll
            for (int k = 0; k < kPixels; ++k) {
                before[k] = progress[k];
                for (int warp = 0; warp < kWarps; ++warp) {
                    Progress through = passed[warp][k][lane_id()];
                    if (warp == warp_id()) before[k] = progress[k];
                    progress[k].remaining -= progress[k].transmittance * through.remaining;
                    progress[k].transmittance *= through.transmittance;
                }
                begin(k, before[k]);
            }
            for (u32 i = mine; i < last && __any_sync(kFullWarp, live); ++i) visit(batch[i], batch_rows[i]);
#pragma unroll
            for (int k = 0; k < kPixels; ++k)
                end(k, before[k].transmittance >= transmittance_min &&
                           before[k].transmittance * own[k].transmittance < transmittance_min);
        }
    }
};

}  // namespace envgs
