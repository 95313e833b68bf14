// From primitives in drawing order to a list for each tile: an instance is a primitive in a tile. Instances are written
// primitive after primitive, nearest first, and a stable sort by tile then leaves each tile's list in drawing order.
#include "raster.cuh"

using namespace envgs;

constexpr u32 kAlone = 8;  // tiles up to which a thread writes a primitive's instances alone

// Where instances go.
struct InstanceWriter {
    u32* tile_keys;
    u32* instance_slots;
    u32 capacity;
    int tiles_x;

    // The instances of a primitive in some tiles of a row, from place `at` on.
    ENVGS_FN void write(u64 at, int row, Columns columns, u32 slot) const {
        for (int column = columns.first; column <= columns.last && at < capacity; ++column, ++at) {
            tile_keys[at] = row * tiles_x + column;
            instance_slots[at] = slot;
        }
    }
};

extern "C" __global__ void __launch_bounds__(256)
    emit_instances(const u32* order,         // [visible] slots, nearest first; a thread a primitive
                   const Outline* outlines,  // [visible] by slot, pixels
                   const u32* tile_counts,   // [visible] by slot: tiles that may be touched
                   Counters* counters,       // [1] drawn_instances is written
                   u32 capacity,             // instances there is room for
                   int tiles_x,              // tiles in a row of the image
                   u32* tile_keys,           // [capacity] tile of each instance
                   u32* instance_slots,      // [capacity] slot of each instance's primitive
                   u64* state,               // [blocks] prefix sums of earlier blocks, zeroed before
                   u32* ticket               // [1] blocks started so far, zeroed before
    ) {
    __shared__ u64 first_instance;
    u32 block = take_ticket(ticket), visible = counters->visible;
    if (u64(block) * 256 >= visible) return;
    u32 at = block * 256 + threadIdx.x, total;
    u32 slot = at < visible ? order[at] : 0, tiles = at < visible ? tile_counts[slot] : 0;
    u32 before = block_exclusive_sum(tiles, total);
    if (warp_id() == 0) {
        u64 first = sum_before_block(state, block, total);
        if (lane_id() == 0) {
            first_instance = first;
            if (at + 256 >= visible) counters->drawn_instances = u32(min(first + total, u64(capacity)));
        }
    }
    __syncthreads();
    InstanceWriter writer = {tile_keys, instance_slots, capacity, tiles_x};
    if (tiles > 0 && tiles <= kAlone) {
        Outline outline = outlines[slot];
        u64 instance = first_instance + before;
        for (int row = outline.box.row0 / kTile; row <= outline.box.row1 / kTile; ++row) {
            Columns columns = tiles_in<kTile>(outline, row);
            writer.write(instance, row, columns, slot);
            instance += columns.last - columns.first + 1;
        }
    }
    // A larger one is its warp's work, a row a thread: one thread would keep the others waiting.
    for (u32 rest = __ballot_sync(kFullWarp, tiles > kAlone); rest; rest &= rest - 1) {
        int owner = __ffs(rest) - 1;
        u32 whose = __shfl_sync(kFullWarp, slot, owner);
        u64 instance = first_instance + __shfl_sync(kFullWarp, before, owner);
        Outline outline = outlines[whose];
        for (int first = outline.box.row0 / kTile, last = outline.box.row1 / kTile; first <= last; first += 32) {
            int row = first + lane_id();
            Columns columns = {1, 0};
            if (row <= last) columns = tiles_in<kTile>(outline, row);
            u32 width = columns.last - columns.first + 1, through = warp_inclusive_sum(width);
            writer.write(instance + through - width, row, columns, whose);
            instance += __shfl_sync(kFullWarp, through, 31);
        }
    }
}

extern "C" __global__ void find_tile_ranges(
    const u32* tile_keys,      // [instances] tile of each instance, ascending
    const Counters* counters,  // [1]
    uint2* ranges              // [tiles] first and past-the-last instance, zeroed before for the tiles without any
) {
    u32 n = counters->drawn_instances, i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= n) return;
    u32 tile = tile_keys[i];
    if (i == 0 || tile_keys[i - 1] != tile) ranges[tile].x = i;
    if (i == n - 1 || tile_keys[i + 1] != tile) ranges[tile].y = i + 1;
}
