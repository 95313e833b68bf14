// A thread or more a surfel, before and after tracing: its appearance is packed, its sums become gradients.
#include "trace.cuh"

using namespace envgs;

// The largest half in place of what is beyond it. In this order: NaN stays NaN.
ENVGS_FN float within_halves(float value) { return maximum(-kLargestHalf, minimum(kLargestHalf, value)); }

// Packs the surfels' appearances in the BVH's order; a thread a word.
extern "C" __global__ void pack_appearances(const u32* order,     // [N] indices of surfels in the BVH's order
                                            const float* sh,      // [N, K, 3] SH coefficients, or sites
                                            const float* extras,  // [N, E] further values to blend
                                            int count,            // N
                                            u32* appearances      // [N, kAppearance] by slot, see PackedAppearance
) {
    long at = long(blockIdx.x) * blockDim.x + threadIdx.x;
    long slot = at / kAppearance;
    int k = at % kAppearance;
    if (slot >= count) return;
    long i = order[slot];
    auto value = [&](int k) {
        if (k < kShFloats) return sh[i * kShFloats + k];
        return k < kShFloats + kExtras ? extras[i * kExtras + k - kShFloats] : 0.0f;
    };
    if constexpr (kColorAlone)
        appearances[at] = halves_of(within_halves(value(2 * k)), within_halves(value(2 * k + 1)));
    else
        appearances[at] = __float_as_uint(value(k));
}

// Every row of the results is written, zeros where no ray hit the surfel.
extern "C" __global__ void __launch_bounds__(128)
    finish_surfels(const float* quaternions,  // [N, 4] wxyz, local to world, any non-zero norm; rows begin at 16 bytes
                   const float* scales,       // [N, 2] standard deviations, world units; rows begin at 8 bytes
                   int count,                 // N
                   const float* weights,      // [N] sums of the blending weights; 0 where no ray hit the surfel
                   const float* sums,         // [N, kTraceSums] by index
                   float* g_means,            // [N, 3] dL/dmeans
                   float* g_quaternions,      // [N, 4] dL/dquaternions
                   float* g_scales,           // [N, 2] dL/dscales
                   float* g_opacities,        // [N] dL/dopacities
                   float* g_sh,               // [N, K, 3] dL/dsh
                   float* g_extras,           // [N, E] dL/dextras
                   float* position_gradients  // [N, 3] sum over hits of t·dL/dmean, world frame
    ) {
    constexpr int row = kTraceSums + 1;  // odd: neighboring threads fall on neighboring banks
    __shared__ float staged[128 * row];
    __shared__ bool seen[128];
    long first = long(blockIdx.x) * 128, i = first + threadIdx.x;
    int here = min(128l, count - first);
    seen[threadIdx.x] = threadIdx.x < here && weights[i] > 0.0f;
    __syncthreads();
    for (int k = threadIdx.x; k < here * kTraceSums; k += 128) {
        int owner = k / kTraceSums;
        staged[owner * row + k % kTraceSums] = seen[owner] ? sums[first * kTraceSums + k] : 0.0f;
    }
    __syncthreads();
    if (threadIdx.x < here) {
        const float* sum = staged + row * threadIdx.x;
        SurfelGradient<float> g = {};
        Quaternion<float> g_q = {};
        if (seen[threadIdx.x]) {
            float inverse_norm;
            float4 raw = reinterpret_cast<const float4*>(quaternions)[i];
            Quaternion<float> q = normalized<float>({raw.x, raw.y, raw.z, raw.w}, inverse_norm);
            float2 scale = reinterpret_cast<const float2*>(scales)[i];
            SurfelMoments<float> moments = {load3(sum), load3(sum + 3), load3(sum + 6), load3(sum + 9)};
            g = surfel_backward(axes_of(q), scale.x, scale.y, moments, load3(sum + kNormalSum));
            g_q = quaternion_gradient(q, inverse_norm, g.torque);
        }
        store3(g_means + 3 * i, g.mean + load3(sum + kDirectionSum));
        store3(position_gradients + 3 * i, g.position_statistic);
        reinterpret_cast<float4*>(g_quaternions)[i] = make_float4(g_q.w, g_q.x, g_q.y, g_q.z);
        reinterpret_cast<float2*>(g_scales)[i] = make_float2(g.scale_u, g.scale_v);
        g_opacities[i] = sum[kOpacitySum];
    }
    for (int k = threadIdx.x; k < here * kShFloats; k += 128)
        g_sh[first * kShFloats + k] = staged[k / kShFloats * row + kShSums + k % kShFloats];
#if EXTRAS > 0
    for (int k = threadIdx.x; k < here * kExtras; k += 128)
        g_extras[first * kExtras + k] = staged[k / kExtras * row + kShSums + kShFloats + k % kExtras];
#endif
}
