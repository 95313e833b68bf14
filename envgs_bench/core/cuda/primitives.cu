// A thread a primitive: before the tiles, which are visible and what they look like; after them, their gradients.
#include "raster.cuh"

using namespace envgs;

// Visible primitives move up in the order of their index: their splats, outlines, depths as sort keys and numbers of
// tiles; slots [N] tells where a primitive went, −1 where nowhere, and indices [visible] the way back. For color alone
// neither is asked for, nor are the weights.
extern "C" __global__ void __launch_bounds__(256) prepare_primitives(
    const float* means,              // [N, 3] centers, world units
    const float* quaternions,        // [N, 4] wxyz, local to world, any non-zero norm; rows begin at 16 bytes
    const float* scales,             // [N, 2] of surfels, [N, 3] of 3D Gaussians: standard deviations, world units
    const float* opacities,          // [N] in [0, 1]
    const float* sh,                 // [N, K, 3] SH coefficients, or sites
    const float* extras,             // [N, E] further values to blend
    int count,                       // N
    const PinholeCamera* camera_at,  // [1]
    VisiblePrimitive* primitives,    // [N] room for all; slots [0, visible) are written
    Outline* outlines,               // [N] by slot, pixels
    u32* depth_keys,                 // [N] by slot: the center's depth as sortable bits
    u32* tile_counts,                // [N] by slot: tiles that may be touched
    int* slots,                      // [N] each primitive's slot; −1 where not visible
    int* indices,                    // [N] by slot: the primitive's index
    float* weights,                  // [N] set to zero
    Counters* counters,              // [1] zeroed before
    u64* state,                      // [blocks] prefix sums of earlier blocks, zeroed before
    u32* ticket                      // [1] blocks started so far, zeroed before
) {
    __shared__ PinholeCamera camera;
    __shared__ u32 first_slot;
    u32 block = take_ticket(ticket);
    for (int i = threadIdx.x; i < sizeof(PinholeCamera) / 4; i += blockDim.x)
        reinterpret_cast<u32*>(&camera)[i] = reinterpret_cast<const u32*>(camera_at)[i];
    __syncthreads();
    Gaussians g = {means, quaternions, scales, opacities, sh, extras, count};
    int i = block * blockDim.x + threadIdx.x;
    VisiblePrimitive primitive;
    Outline outline;
    u32 tiles = 0;
    Vec3<float> to_center;
    if (i < count) {
        Kind::Input input = Kind::input(g, i);
        PixelBox box = prepare(camera, input, opacities[i], primitive.splat);
        PixelRect rect;
        if (pixels_of(camera, box, rect)) {
            outline = outline_of(camera, input, primitive.splat, rect);
            tiles = count_tiles(outline);
            primitive.take(normal_of(input), extras + long(kExtras) * i);
            to_center = input.mean - camera.center;
        }
    }
    u32 total, before = block_exclusive_sum(tiles > 0, total);
    u32 block_tiles, unused = block_exclusive_sum(min(tiles, 1u << 22), block_tiles);
    if (warp_id() == 0) {
        u32 first = sum_before_block(state, block, total);
        if (lane_id() == 0) {
            first_slot = first;
            if (block_tiles) atomicAdd(&counters->instances, u64(block_tiles));
            if (block == gridDim.x - 1) counters->visible = first + total;
        }
    }
    __syncthreads();
    if (i >= count) return;
    if constexpr (!kColorAlone) {
        weights[i] = 0.0f;
        if (tiles == 0) slots[i] = -1;
    }
    if (tiles == 0) return;
    u32 slot = first_slot + before;
    primitive.color = seen_color(sh + long(kShFloats) * i, to_center);
    if constexpr (!kColorAlone) {
        slots[i] = slot;
        indices[slot] = i;
    }
    primitives[slot] = primitive;
    outlines[slot] = outline;
    depth_keys[slot] = sortable_bits(primitive.splat.depth);
    tile_counts[slot] = tiles;
}

// Per primitive: from the sums over its pixels to the gradients of what it was given by. Every row of the results is
// written, zeros where the primitive was not visible.
extern "C" __global__ void __launch_bounds__(128) finish_primitives(
    const float* means,                  // [N, 3] centers, world units
    const float* quaternions,            // [N, 4] wxyz, local to world, any non-zero norm; rows begin at 16 bytes
    const float* scales,                 // [N, 2] of surfels, [N, 3] of 3D Gaussians: standard deviations, world units
    const float* opacities,              // [N] in [0, 1]
    const float* sh,                     // [N, K, 3] SH coefficients, or sites
    const float* extras,                 // [N, E] further values to blend
    int count,                           // N
    const PinholeCamera* camera_at,      // [1]
    const VisiblePrimitive* primitives,  // [visible] by slot
    const int* slots,                    // [N] each primitive's slot; −1 where not visible
    const float* sums,                   // [visible, kSumsStride] PrimitiveSums over all pixels, by slot
    float* g_means,                      // [N, 3] dL/dmeans
    float* g_quaternions,                // [N, 4] dL/dquaternions
    float* g_scales,                     // [N, 2] or [N, 3] dL/dscales
    float* g_opacities,                  // [N] dL/dopacities
    float* g_sh,                         // [N, K, 3] dL/dsh
    float* g_extras,                     // [N, E] dL/dextras
    float* position_gradients            // [N, 3] sum over hits of t·dL/dmean, world frame
) {
    constexpr int row = kShFloats | 1;  // odd: neighboring threads fall on neighboring banks
    __shared__ float staged[128 * row];
    __shared__ PinholeCamera camera;
    for (int i = threadIdx.x; i < sizeof(PinholeCamera) / 4; i += blockDim.x)
        reinterpret_cast<u32*>(&camera)[i] = reinterpret_cast<const u32*>(camera_at)[i];
    float* g_own_sh = staged + row * threadIdx.x;
    for (int k = 0; k < kShFloats; ++k) g_own_sh[k] = 0.0f;
    __syncthreads();
    Gaussians g = {means, quaternions, scales, opacities, sh, extras, count};
    long first = long(blockIdx.x) * blockDim.x, i = first + threadIdx.x;
    if (i < count) {
        int slot = slots[i];
        SplatGradient own = {};
        PrimitiveSums sum = {};
        if (slot >= 0) {
            const float4* from = reinterpret_cast<const float4*>(sums + long(kSumsStride) * slot);
            float values[kSumsStride];
#pragma unroll
            for (int k = 0; k < kSumsStride / 4; ++k) {
                float4 value4 = from[k];
                values[4 * k] = value4.x, values[4 * k + 1] = value4.y, values[4 * k + 2] = value4.z;
                values[4 * k + 3] = value4.w;
            }
#pragma unroll
            for (int k = 0; k < kSums; ++k) reinterpret_cast<float*>(&sum)[k] = values[k];
            Kind::Input input = Kind::input(g, i);
            own = finish(camera, input, sum.geometry, sum.normal);
            own.mean = own.mean + seen_color_backward(sh + kShFloats * i, input.mean - camera.center,
                                                      primitives[slot].color, sum.color, g_own_sh);
        }
        store3(g_means + 3 * i, own.mean);
        store3(position_gradients + 3 * i, own.position_statistic);
        reinterpret_cast<float4*>(g_quaternions)[i] =
            make_float4(own.quaternion.w, own.quaternion.x, own.quaternion.y, own.quaternion.z);
        const float own_scales[3] = {own.scales.x, own.scales.y, own.scales.z};
#pragma unroll
        for (int k = 0; k < Kind::scale_count; ++k) g_scales[Kind::scale_count * i + k] = own_scales[k];
        g_opacities[i] = sum.opacity;
#pragma unroll
        for (int k = 0; k < kExtras; ++k) g_extras[kExtras * i + k] = sum.extras[k];
    }
    __syncthreads();
    long floats = min(long(blockDim.x), count - first) * kShFloats;
    for (int k = threadIdx.x; k < floats; k += blockDim.x)
        g_sh[first * kShFloats + k] = staged[k / kShFloats * row + k % kShFloats];
}
