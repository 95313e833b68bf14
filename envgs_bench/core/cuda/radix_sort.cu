// Stable least-significant-digit radix sort of 32-bit keys with 32-bit values, eight bits a pass, each key read and
// written once a pass (Onesweep, Adinets and Merrill 2022). The number of keys may live on the device: `count` is read
// there, and grids are sized for the capacity.
#include "warp.cuh"

using namespace envgs;

constexpr int kDigits = DIGITS, kTileKeys = KEYS_PER_BLOCK;
constexpr int kThreads = kDigits, kWarps = kThreads / 32, kItems = kTileKeys / kThreads;
static_assert(kItems * kThreads == kTileKeys);

// Counts the keys' digits for all passes.
extern "C" __global__ void radix_histograms(
    const u32* keys,   // [capacity]
    const u32* count,  // [1] how many of the keys count
    u32 capacity,      // length of `keys`
    int passes,        // 1 to 4, eight bits each
    u32* histograms    // [passes, 256] keys that have digit d at pass p, zeroed before
) {
    __shared__ u32 local[4 * kDigits];
    for (int i = threadIdx.x; i < passes * kDigits; i += blockDim.x) local[i] = 0;
    __syncthreads();
    u32 n = min(*count, capacity);
    for (u32 i = blockIdx.x * blockDim.x + threadIdx.x; i < n; i += gridDim.x * blockDim.x) {
        u32 key = keys[i];
        for (int p = 0; p < passes; ++p) atomicAdd(&local[p * kDigits + (key >> 8 * p & 255)], 1);
    }
    __syncthreads();
    for (int i = threadIdx.x; i < passes * kDigits; i += blockDim.x)
        if (local[i]) atomicAdd(&histograms[i], local[i]);
}

// One pass; thread d looks back for digit d.
extern "C" __global__ void __launch_bounds__(kThreads)
    radix_pass(const u32* keys_in,    // [capacity]
               const u32* values_in,  // [capacity], or null for the keys' own positions
               u32* keys_out,         // [capacity]
               u32* values_out,       // [capacity]
               const u32* count,      // [1] how many of the keys count
               u32 capacity,          // length of the arrays
               int shift,             // lowest bit of this pass's digit
               const u32* histogram,  // [256] of this pass's digit
               u32* state,            // [tiles, 256] prefix sums of earlier tiles, zeroed before
               u32* ticket            // [1] tiles started so far, zeroed before
    ) {
    __shared__ u32 warp_counts[kWarps][kDigits];
    __shared__ u32 tile_offset[kDigits];    // where the tile's digit starts among its sorted keys
    __shared__ u32 global_offset[kDigits];  // where it goes, less tile_offset
    __shared__ u32 sorted[kTileKeys];
    u32 n = min(*count, capacity);
    u32 tile = take_ticket(ticket);
    if (u64(tile) * kTileKeys >= n) return;
    u32 begin = tile * kTileKeys, here = min(u32(kTileKeys), n - begin);
    for (int i = threadIdx.x; i < kWarps * kDigits; i += kThreads) (&warp_counts[0][0])[i] = 0;

    u32 keys[kItems], values[kItems], ranks[kItems];
    u32 first = warp_id() * (32 * kItems) + lane_id();
#pragma unroll
    for (int i = 0; i < kItems; ++i) {
        u32 at = first + 32 * i;
        keys[i] = at < here ? keys_in[begin + at] : 0xffffffffu;
    }
#pragma unroll
    for (int i = 0; i < kItems; ++i) {
        u32 at = first + 32 * i;
        values[i] = at >= here ? 0 : values_in ? values_in[begin + at] : begin + at;
    }
    __syncthreads();
    // Rank within the warp: equal digits of one row of 32, after those of the rows before. What lies past the end has
    // the highest digit and comes last.
    u32* own = warp_counts[warp_id()];
#pragma unroll
    for (int i = 0; i < kItems; ++i) {
        u32 digit = keys[i] >> shift & 255;
        u32 peers = __match_any_sync(kFullWarp, digit);
        u32 below = __popc(peers & ((1u << lane_id()) - 1));
        u32 before = own[digit];
        __syncwarp();
        if (below == 0) own[digit] = before + __popc(peers);
        __syncwarp();
        ranks[i] = before + below;
    }
    __syncthreads();
    // Thread d: digit d's counts become offsets of the warps, and its place in the whole.
    u32 digit = threadIdx.x, sum = 0;
#pragma unroll
    for (int w = 0; w < kWarps; ++w) {
        u32 c = warp_counts[w][digit];
        warp_counts[w][digit] = sum;
        sum += c;
    }
    u32 total, offset = block_exclusive_sum(sum, total);
    u32 base = block_exclusive_sum(histogram[digit], total);
    if (digit == 255) sum -= kTileKeys - here;
    // Flags as in sum_before_block, in 32 bits: counts stay below 2³⁰.
    constexpr u32 partial = 1u << 30, complete = 2u << 30, value = partial - 1;
    volatile u32* column = state + digit;
    u32 before = 0;
    if (tile == 0) {
        column[0] = complete | sum;
    } else {
        column[tile * kDigits] = partial | sum;
        for (long i = long(tile) - 1;;) {
            u32 word = column[i * kDigits];
            if (word < partial) continue;
            before += word & value;
            if (word >= complete) break;
            --i;
        }
        column[tile * kDigits] = complete | (before + sum);
    }
    tile_offset[digit] = offset;
    global_offset[digit] = base + before - offset;
    __syncthreads();
#pragma unroll
    for (int i = 0; i < kItems; ++i) {
        u32 d = keys[i] >> shift & 255;
        ranks[i] += tile_offset[d] + own[d];
        sorted[ranks[i]] = keys[i];
    }
    __syncthreads();
    // Neighboring threads now hold neighboring keys, so that writes coalesce; values follow by the same way.
    u32 to[kItems];
#pragma unroll
    for (int i = 0; i < kItems; ++i) {
        u32 at = threadIdx.x + kThreads * i;
        u32 key = sorted[at];
        to[i] = global_offset[key >> shift & 255] + at;
        if (at < here) keys_out[to[i]] = key;
    }
    __syncthreads();
#pragma unroll
    for (int i = 0; i < kItems; ++i) sorted[ranks[i]] = values[i];
    __syncthreads();
#pragma unroll
    for (int i = 0; i < kItems; ++i) {
        u32 at = threadIdx.x + kThreads * i;
        if (at < here) values_out[to[i]] = sorted[at];
    }
}
