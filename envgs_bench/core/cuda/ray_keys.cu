// The order in which rays are traced.
#include "trace.cuh"

using namespace envgs;

// Rays whose two ends are alike get neighboring keys: the origin, and the point where the ray leaves the box of the
// surfels, which is near the surfels that it hits. Both lie on Hilbert curves, and the key takes three bits of either
// in turn. The tracer's packets are rays along this order, whatever order the caller's rays come in. Rays without a
// direction hit nothing and come last.
extern "C" __global__ void ray_keys(const float* origins,     // [R, 3] world units
                                    const float* directions,  // [R, 3] world frame, any length; zero hits nothing
                                    int count,                // R
                                    const CenterStatistics* statistics,  // [1] extent of the surfels' centers
                                    u32* keys  // [R] sorts like rays together; all ones for rays without a direction
) {
    int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count) return;
    Extent extent(*statistics);
    Vec3<float> o = load3(origins + 3l * i), d = load3(directions + 3l * i), high = extent.low + extent.size;
    float x = ((d.x > 0.0f ? high.x : extent.low.x) - o.x) / d.x;
    float y = ((d.y > 0.0f ? high.y : extent.low.y) - o.y) / d.y;
    float z = ((d.z > 0.0f ? high.z : extent.low.z) - o.z) / d.z;
    float t_exit = kInfinity;
    if (x > 0.0f) t_exit = minimum(t_exit, x);
    if (y > 0.0f) t_exit = minimum(t_exit, y);
    if (z > 0.0f) t_exit = minimum(t_exit, z);
    u32 first[3], last[3];
    extent.quantize(o, 5, first);
    extent.quantize(o + t_exit * d, 6, last);
    u64 from = hilbert_position(first, 5), to = hilbert_position(last, 6), key = to >> 15;
    for (int bit = 12; bit >= 0; bit -= 3) key = (key << 3 | (from >> bit & 7)) << 3 | (to >> bit & 7);
    bool has_direction = d.x != 0.0f || d.y != 0.0f || d.z != 0.0f;
    keys[i] = has_direction ? u32(key >> 1) : ~0u;
}
