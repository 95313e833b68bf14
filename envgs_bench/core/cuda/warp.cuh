// What the 32 threads of a warp do together, and what the blocks of a grid tell each other while they run.
#pragma once

namespace envgs {

constexpr unsigned kFullWarp = 0xffffffffu;
using u32 = unsigned int;
using u64 = unsigned long long;

__device__ __forceinline__ int lane_id() { return threadIdx.x & 31; }
__device__ __forceinline__ int warp_id() { return threadIdx.x >> 5; }

// Floats as unsigned integers of the same order.
__device__ __forceinline__ u32 sortable_bits(float value) {
    u32 bits = __float_as_uint(value);
    return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}
__device__ __forceinline__ float from_sortable_bits(u32 bits) {
    return __uint_as_float(bits & 0x80000000u ? bits & 0x7fffffffu : ~bits);
}
__device__ __forceinline__ float warp_min(float value) {
    return from_sortable_bits(__reduce_min_sync(kFullWarp, sortable_bits(value)));
}
__device__ __forceinline__ float warp_max(float value) {
    return from_sortable_bits(__reduce_max_sync(kFullWarp, sortable_bits(value)));
}

// The sum over the warp of values in [0, 1] of which each thread has added up `Of`, by integer hardware and so in any
// order the same: steps of Of·2⁻²⁶.
template <int Of>
__device__ __forceinline__ float warp_sum_of_weights(float value) {
    constexpr float steps = 67108864.0f / Of;
    return __reduce_add_sync(kFullWarp, u32(value * steps)) * (1.0f / steps);
}

__device__ __forceinline__ u32 warp_inclusive_sum(u32 value) {
#pragma unroll
    for (int offset = 1; offset < 32; offset *= 2) {
        u32 below = __shfl_up_sync(kFullWarp, value, offset);
        if (lane_id() >= offset) value += below;
    }
    return value;
}

// Exclusive prefix sums over a block of up to 1024 threads; `total` is the whole block's sum.
__device__ __forceinline__ u32 block_exclusive_sum(u32 value, u32& total) {
    __shared__ u32 warp_sums[32];
    u32 inclusive = warp_inclusive_sum(value);
    if (lane_id() == 31) warp_sums[warp_id()] = inclusive;
    __syncthreads();
    if (warp_id() == 0) {
        u32 sum = lane_id() < blockDim.x / 32 ? warp_sums[lane_id()] : 0;
        warp_sums[lane_id()] = warp_inclusive_sum(sum);
    }
    __syncthreads();
    u32 before = (warp_id() ? warp_sums[warp_id() - 1] : 0) + inclusive - value;
    total = warp_sums[blockDim.x / 32 - 1];
    __syncthreads();
    return before;
}

// Sums K ≤ 32 values over the warp: lane k returns the total of values[k]. Each step halves the values that a thread
// still carries, so that 31 shuffles do instead of 5·K.
template <int K, int Half = 16>
struct TransposedSum {
    __device__ static __forceinline__ float of(float* values) {
        bool upper = lane_id() & Half;
        constexpr int kept = K < Half ? K : Half;
#pragma unroll
        for (int i = 0; i < kept; ++i) {
            if (i + Half < K) {
                float sent = upper ? values[i] : values[i + Half];
                float own = upper ? values[i + Half] : values[i];
                values[i] = own + __shfl_xor_sync(kFullWarp, sent, Half);
            } else {
                values[i] += __shfl_xor_sync(kFullWarp, values[i], Half);
            }
        }
        return TransposedSum<kept, Half / 2>::of(values);
    }
};
template <int K>
struct TransposedSum<K, 0> {
    __device__ static __forceinline__ float of(float* values) { return values[0]; }
};

// Prefix sums over the blocks of a grid while it runs (decoupled look-back, Merrill and Garland 2016). A block takes
// its number from `ticket`, so that every lower number has already started; `state` and `ticket` are zeroed before.
constexpr u64 kPartial = 1ull << 62, kComplete = 2ull << 62, kValue = kPartial - 1;

__device__ __forceinline__ u32 take_ticket(u32* ticket) {
    __shared__ u32 number;
    if (threadIdx.x == 0) number = atomicAdd(ticket, 1);
    __syncthreads();
    return number;
}

// Called by one whole warp of a block: the sum over all blocks before this one. A lane looks at a block, the nearest
// first.
__device__ __forceinline__ u64 sum_before_block(volatile u64* state, u32 block, u64 own) {
    if (lane_id() == 0) state[block] = (block == 0 ? kComplete : kPartial) | own;
    u64 before = 0;
    u32 complete = 0;
    for (long nearest = long(block) - 1; nearest >= 0 && !complete; nearest -= 32) {
        long other = nearest - lane_id();
        u64 word = kComplete;
        do {
            if (other >= 0) word = state[other];
        } while (__any_sync(kFullWarp, word < kPartial));
        complete = __ballot_sync(kFullWarp, word >= kComplete);
        u64 value = !complete || lane_id() < __ffs(complete) ? word & kValue : 0;  // up to the first that is complete
#pragma unroll
        for (int offset = 16; offset > 0; offset /= 2) value += __shfl_xor_sync(kFullWarp, value, offset);
        before += value;
    }
    if (lane_id() == 0 && block > 0) state[block] = kComplete | (before + own);
    return before;
}

}  // namespace envgs
