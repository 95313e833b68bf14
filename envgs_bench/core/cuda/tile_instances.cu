// From primitives in drawing order to a list for each tile: an instance is a primitive in a tile. Instances are written
// primitive after primitive, nearest first, and a stable sort by tile then leaves each tile's list in drawing order.
#include "raster.cuh"

using namespace envgs;

extern "C" __global__ void __launch_bounds__(256) emit_instances(
    const u32* order,  // [visible] slots, nearest first; a thread a primitive
    const Outline* outlines,  // [visible] by slot, pixels
    const u32* tile_counts,  // [visible] by slot: tiles that may be touched
    Counters* counters,  // [1] drawn_instances is written
    u32 capacity,  // instances there is room for
    int tiles_x,  // tiles in a row of the image
    u32* tile_keys,  // [capacity] tile of each instance
    u32* instance_slots,  // [capacity] slot of each instance's primitive
    u64* state,  // [blocks] prefix sums of earlier blocks, zeroed before
    u32* ticket  // [1] blocks started so far, zeroed before
) {
    __shared__ u64 first_instance;
    u32 block = take_ticket(ticket), visible = counters->visible;
    if (u64(block) * 256 >= visible) return;
    u32 at = block * 256 + threadIdx.x, total;
    u32 slot = at < visible ? order[at] : 0;
    u32 before = block_exclusive_sum(at < visible ? tile_counts[slot] : 0, total);
    if (threadIdx.x == 0) {
        first_instance = sum_before_block(state, block, total);
        if (at + 256 >= visible) counters->drawn_instances = u32(min(first_instance + total, u64(capacity)));
    }
    __syncthreads();
    if (at >= visible) return;
    Outline outline = outlines[slot];
    u64 instance = first_instance + before;
    for (int row = outline.box.row0 / kTile; row <= outline.box.row1 / kTile; ++row) {
        Columns columns = tiles_in(outline, row);
        for (int column = columns.first; column <= columns.last && instance < capacity; ++column, ++instance) {
            tile_keys[instance] = row * tiles_x + column;
            instance_slots[instance] = slot;
        }
    }
}

extern "C" __global__ void find_tile_ranges(
    const u32* tile_keys,  // [instances] tile of each instance, ascending
    const Counters* counters,  // [1]
    uint2* ranges  // [tiles] first and past-the-last instance, zeroed before for the tiles without any
) {
    u32 n = counters->drawn_instances, i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= n) return;
    u32 tile = tile_keys[i];
    if (i == 0 || tile_keys[i - 1] != tile) ranges[tile].x = i;
    if (i == n - 1 || tile_keys[i + 1] != tile) ranges[tile].y = i + 1;
}
