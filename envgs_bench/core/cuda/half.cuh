// Pairs of half-precision floats, a word each. NVRTC comes without cuda_fp16.h, so their two instructions are named
// here; where kernels are emulated, the emulator has them.
#pragma once
#include "warp.cuh"

namespace envgs {

constexpr float kLargestHalf = 65504.0f;

#ifdef __CUDA_ARCH__
// Rounded to nearest.
__device__ __forceinline__ u32 halves_of(float low, float high) {
    u32 pair;
    asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(pair) : "f"(high), "f"(low));
    return pair;
}
__device__ __forceinline__ float2 floats_of(u32 pair) {
    float2 values;
    asm("{ .reg .b16 low, high; mov.b32 {low, high}, %2; cvt.f32.f16 %0, low; cvt.f32.f16 %1, high; }"
        : "=f"(values.x), "=f"(values.y)
        : "r"(pair));
    return values;
}
#endif

}  // namespace envgs
