// Before and after the rays: in which order they are traced, how surfels look, and from sums to gradients.
#include "trace.cuh"

using namespace envgs;

// Rays whose two ends are alike get neighboring keys: the origin, and the point where the ray leaves the box of the
// surfels, which is near to what it hits. Both lie on Hilbert curves, and the key takes three bits of either in turn.
// The tracer's packets are rays along this order, whatever order the caller's rays come in. Rays without a direction
// meet nothing and come last.
extern "C" __global__ void ray_keys(const float* origins, const float* directions, int count,
                                    const CenterStatistics* statistics, u32* keys) {
    int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count) return;
    Extent extent(*statistics);
    Vec3<float> o = load3(origins + 3l * i), d = load3(directions + 3l * i), high = extent.low + extent.size;
    float x = ((d.x > 0.0f ? high.x : extent.low.x) - o.x) / d.x;
    float y = ((d.y > 0.0f ? high.y : extent.low.y) - o.y) / d.y;
    float z = ((d.z > 0.0f ? high.z : extent.low.z) - o.z) / d.z;
    float leaves = kInfinity;
    if (x > 0.0f) leaves = minimum(leaves, x);
    if (y > 0.0f) leaves = minimum(leaves, y);
    if (z > 0.0f) leaves = minimum(leaves, z);
    u32 first[3], last[3];
    extent.quantize(o, 5, first);
    extent.quantize(o + leaves * d, 6, last);
    u64 from = hilbert_position(first, 5), to = hilbert_position(last, 6), key = to >> 15;
    for (int bit = 12; bit >= 0; bit -= 3) key = (key << 3 | (from >> bit & 7)) << 3 | (to >> bit & 7);
    bool flies = d.x != 0.0f || d.y != 0.0f || d.z != 0.0f;
    keys[i] = flies ? u32(key >> 1) : ~0u;
}

// surfels' appearances in the tree's order; a thread a float.
extern "C" __global__ void pack_appearances(const u32* order, const float* sh, const float* extras, int count,
                                            float* appearances) {
    long at = long(blockIdx.x) * blockDim.x + threadIdx.x;
    long slot = at / kAppearance;
    int k = at % kAppearance;
    if (slot >= count) return;
    long i = order[slot];
    float value = 0.0f;
    if (k < kShFloats) value = sh[i * kShFloats + k];
    if (k >= kShFloats && k < kShFloats + kExtras) value = extras[i * kExtras + k - kShFloats];
    appearances[at] = value;
}

// Every row of the results is written, zeros where no ray met the surfel.
extern "C" __global__ void __launch_bounds__(128)
    finish_surfels(const float* quaternions, const float* scales, int count, const float* weights, const float* sums,
                   float* g_means, float* g_quaternions, float* g_scales, float* g_opacities, float* g_sh,
                   float* g_extras, float* position_gradients) {
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
