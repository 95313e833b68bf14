// From primitives in drawing order to a list for each tile: an instance is a primitive in a tile. Instances are written
// primitive after primitive, nearest first, and a stable sort by tile then leaves each tile's list in drawing order.
#include "raster.cuh"

using namespace envgs;

// order [visible]: slots, nearest first. Threads of a block share the block's instances evenly, however unequal the
// primitives are.
extern "C" __global__ void __launch_bounds__(256)
    emit_instances(const u32* order, const Outline* outlines, const u32* tile_counts, Counters* counters, u32 capacity,
                   int tiles_x, u32* tile_keys, u32* instance_slots, u64* state, u32* ticket) {
    __shared__ u32 starts[257], slots[256];
    __shared__ u64 first_instance;
    u32 block = take_ticket(ticket), visible = counters->visible;
    if (u64(block) * 256 >= visible) return;
    u32 at = block * 256 + threadIdx.x;
    u32 slot = at < visible ? order[at] : 0, count = at < visible ? tile_counts[slot] : 0, total;
    starts[threadIdx.x] = block_exclusive_sum(count, total);
    slots[threadIdx.x] = slot;
    if (threadIdx.x == 0) {
        starts[256] = total;
        first_instance = sum_before_block(state, block, total);
        if (at + 256 >= visible) counters->drawn_instances = u32(min(first_instance + total, u64(capacity)));
    }
    __syncthreads();
    for (u32 k = threadIdx.x; k < total && first_instance + k < capacity; k += 256) {
        int owner = 0;
#pragma unroll
        for (int step = 128; step > 0; step /= 2)
            if (starts[owner + step] <= k) owner += step;
        Outline outline = outlines[slots[owner]];
        int skip = k - starts[owner], row = outline.box.row0 / kTile;
        Columns columns = tiles_in(outline, row);
        while (skip > columns.last - columns.first) {
            skip -= columns.last - columns.first + 1;
            columns = tiles_in(outline, ++row);
        }
        tile_keys[first_instance + k] = row * tiles_x + columns.first + skip;
        instance_slots[first_instance + k] = slots[owner];
    }
}

// ranges [tiles]: first and past-the-last instance. Zeroed before, for the tiles without any.
extern "C" __global__ void find_ranges(const u32* tile_keys, const Counters* counters, uint2* ranges) {
    u32 n = counters->drawn_instances, i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= n) return;
    u32 tile = tile_keys[i];
    if (i == 0 || tile_keys[i - 1] != tile) ranges[tile].x = i;
    if (i == n - 1 || tile_keys[i + 1] != tile) ranges[tile].y = i + 1;
}
