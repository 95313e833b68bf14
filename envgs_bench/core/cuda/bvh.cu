// Builds the BVH: the centers' extent, keys along the curve, (a sort), surfels packed in that order with their
// boxes, 32 neighbors at a time arranged into good leaves, and the levels above. Refitting to changed surfels repeats
// only the last two, and keeps the leaves.
#include "bvh.cuh"

using namespace envgs;

extern "C" __global__ void __launch_bounds__(256)
    center_statistics(const float* means,           // [N, 3] centers, world units
                      int count,                    // N
                      CenterStatistics* statistics  // [1] `low` set to all ones before, the rest to zero
    ) {
    float low[3], high[3], sum[3] = {}, squares[3] = {}, finite = 0.0f;
    for (int k = 0; k < 3; ++k) low[k] = kInfinity, high[k] = -kInfinity;
    for (int i = blockIdx.x * blockDim.x + threadIdx.x; i < count; i += gridDim.x * blockDim.x) {
        float p[3] = {means[3l * i], means[3l * i + 1], means[3l * i + 2]};
        if (!(absolute(p[0]) < kInfinity && absolute(p[1]) < kInfinity && absolute(p[2]) < kInfinity)) continue;
        finite += 1.0f;
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            low[k] = minimum(low[k], p[k]), high[k] = maximum(high[k], p[k]);
            sum[k] += p[k], squares[k] += p[k] * p[k];
        }
    }
    __shared__ CenterStatistics block;
    for (int i = threadIdx.x; i < sizeof(block) / 4; i += blockDim.x)
        reinterpret_cast<u32*>(&block)[i] = i < 3 ? ~0u : 0;
    __syncthreads();
    for (int k = 0; k < 3; ++k) {
        atomicMin(&block.low[k], sortable_bits(low[k]));
        atomicMax(&block.high[k], sortable_bits(high[k]));
    }
    float values[7] = {sum[0], sum[1], sum[2], squares[0], squares[1], squares[2], finite};
    float total = TransposedSum<7>::of(values);
    constexpr int before_sums = 6;  // in the struct, as what follows are `sum`, `squares` and `count`
    float* block_sums = reinterpret_cast<float*>(&block) + before_sums;
    if (lane_id() < 7) atomicAdd(block_sums + lane_id(), total);
    __syncthreads();
    if (threadIdx.x < 3) {
        atomicMin(&statistics->low[threadIdx.x], block.low[threadIdx.x]);
        atomicMax(&statistics->high[threadIdx.x], block.high[threadIdx.x]);
    }
    float* sums = reinterpret_cast<float*>(statistics) + before_sums;
    if (threadIdx.x < 7) atomicAdd(sums + threadIdx.x, block_sums[threadIdx.x]);
}

extern "C" __global__ void hilbert_keys(
    const float* means,                  // [N, 3] centers, world units
    const float* opacities,              // [N] in [0, 1]
    int count,                           // N
    const CenterStatistics* statistics,  // [1] extent of the centers
    u32* keys                            // [N] position along the curve, 30 bits; all ones where never visible
) {
    int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count) return;
    u32 cell[3];
    Extent(*statistics).quantize(load3(means + 3l * i), 10, cell);
    keys[i] = support_of(opacities[i]) > 0.0f ? hilbert_position(cell, 10) : 0xffffffffu;
}

struct Aabb {
    float low[3], high[3];
};

ENVGS_FN Aabb empty_box() { return {{kInfinity, kInfinity, kInfinity}, {-kInfinity, -kInfinity, -kInfinity}}; }

// Around the supporting disc: along each axis r·√((s_u·t_u)² + (s_v·t_v)²), and a hair for the rounding of this and of
// the shafts that it is tested against.
ENVGS_FN Aabb box_of(Vec3<float> center, float support, Vec3<float> axis_u, Vec3<float> axis_v) {
    float u[3] = {axis_u.x, axis_u.y, axis_u.z}, v[3] = {axis_v.x, axis_v.y, axis_v.z};
    float mean[3] = {center.x, center.y, center.z};
    Aabb box;
    bool finite = support > 0.0f;
    for (int k = 0; k < 3; ++k) {
        float half = square_root(support * (u[k] * u[k] + v[k] * v[k]));
        half += 8e-6f * (absolute(mean[k]) + half);
        box.low[k] = mean[k] - half, box.high[k] = mean[k] + half;
        finite = finite && box.low[k] > -kInfinity && box.high[k] < kInfinity;
    }
    return finite ? box : empty_box();
}

// The union over a warp, written by its first lane.
ENVGS_FN void store_union(Aabb box, float2* boxes, int stride, int at) {
#pragma unroll
    for (int k = 0; k < 3; ++k) {
        float low = warp_min(box.low[k]), high = warp_max(box.high[k]);
        if (lane_id() == 0) boxes[long(k) * stride + at] = make_float2(low, high);
    }
}

ENVGS_FN float half_area(const Aabb& b) {
    float x = maximum(b.high[0] - b.low[0], 0.0f), y = maximum(b.high[1] - b.low[1], 0.0f);
    float z = maximum(b.high[2] - b.low[2], 0.0f);
    return x * y + y * z + z * x;
}

// The union over runs of `Lanes` threads.
template <int Lanes>
__device__ __forceinline__ Aabb merged(Aabb box) {
#pragma unroll
    for (int offset = 1; offset < Lanes; offset *= 2)
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            box.low[k] = minimum(box.low[k], __shfl_xor_sync(kFullWarp, box.low[k], offset));
            box.high[k] = maximum(box.high[k], __shfl_xor_sync(kFullWarp, box.high[k], offset));
        }
    return box;
}

// What a warp's threads pass around while they arrange their surfels.
struct Scratch {
    Aabb boxes[32];
    int threads[32];
};

// Halves runs of `Lanes` boxes, a thread each: along that of four orders (the centers' coordinates, and size) whose
// halves have the least area together. `from` is the thread that a box came from; those from `present` on pad.
template <int Lanes>
__device__ __forceinline__ void halve(Aabb& box, int& from, int present, Scratch& scratch) {
    float least = kInfinity;
    int chosen = lane_id();
#pragma unroll 1
    for (int order = 0; order < 4; ++order) {
        float along = order == 0   ? box.low[0] + box.high[0]
                      : order == 1 ? box.low[1] + box.high[1]
                      : order == 2 ? box.low[2] + box.high[2]
                                   : half_area(box);
        // The thread's number in the lowest bits: no two are equal. Padding comes last.
        u32 key = ((from < present ? min(sortable_bits(along), 0xffffffbfu) : ~0u) & ~31u) | lane_id();
        int place = lane_id() & ~(Lanes - 1);
#pragma unroll
        for (int other = 1; other < Lanes; ++other) place += __shfl_xor_sync(kFullWarp, key, other) < key;
        scratch.boxes[place] = box;
        __syncwarp();
        float area = half_area(merged<Lanes / 2>(scratch.boxes[lane_id()]));
        area += __shfl_xor_sync(kFullWarp, area, Lanes / 2);
        if (area < least) least = area, chosen = place;
        __syncwarp();
    }
    scratch.boxes[chosen] = box, scratch.threads[chosen] = from;
    __syncwarp();
    box = scratch.boxes[lane_id()], from = scratch.threads[lane_id()];
    __syncwarp();
}

// A thread a surfel, in the order of the curve; further threads pad leaves and the two lowest levels.
extern "C" __global__ void __launch_bounds__(256)
    pack_surfels(const float* means,        // [N, 3] centers, world units
                 const float* quaternions,  // [N, 4] wxyz, local to world, any non-zero norm; rows begin at 16 bytes
                 const float* scales,       // [N, 2] standard deviations, world units; rows begin at 8 bytes
                 const float* opacities,    // [N] in [0, 1]
                 int count,                 // N
                 u32* order,                // [N] indices of surfels along the curve; 32 neighbors become good leaves
                 float4* packed_surfels,    // [leaves, 3, kLeaf] see PackedSurfels
                 float2* boxes              // [3, boxes] (low, high) of each box and axis, world units: see Levels
    ) {
    Levels levels = Levels::of(count);
    int stride = levels.total(), slot = blockIdx.x * blockDim.x + threadIdx.x, leaf = slot / kLeaf;
    Aabb box = empty_box();
    TracedSurfel s = {};
    s.index = -1;
    float scale_u_over_v = 0.0f;
    if (slot < count) {
        Gaussians g = {means, quaternions, scales, opacities, nullptr, nullptr, count};
        int i = order[slot];
        float inverse_norm;
        float2 scale = reinterpret_cast<const float2*>(scales)[i];
        Axes<float> axes = axes_of(normalized(quaternion_at(g, i), inverse_norm));
        s = {surfel_frame(axes, scale.x, scale.y), mean_at(g, i), opacities[i], i};
        scale_u_over_v = scale.x / scale.y;
        box = box_of(s.mean, support_of(s.opacity), scale.x * axes.u, scale.y * axes.v);
        if (!(box.low[0] <= box.high[0])) s.opacity = 0.0f;  // no ray hits it, whatever its leaf's box
    }
    __shared__ Scratch scratches[8];
    Scratch& scratch = scratches[warp_id()];
    int from = lane_id(), present = count - (slot - lane_id());
    static_assert(kLeaf == 4, "three halvings");
    halve<32>(box, from, present, scratch);
    halve<16>(box, from, present, scratch);
    halve<8>(box, from, present, scratch);
    scratch.threads[from] = lane_id();
    __syncwarp();
    int own_slot = slot + scratch.threads[lane_id()] - lane_id();
    if (own_slot < count) order[own_slot] = s.index;
    if (leaf < levels.offset[1]) PackedSurfels{packed_surfels}.store(own_slot, s, scale_u_over_v);
    box = merged<kLeaf>(box);
    __shared__ Aabb leaves[256 / kLeaf];
    if (slot % kLeaf == 0) {
        leaves[threadIdx.x / kLeaf] = box;
        if (leaf < levels.offset[1])
#pragma unroll
            for (int k = 0; k < 3; ++k) boxes[long(k) * stride + leaf] = make_float2(box.low[k], box.high[k]);
    }
    __syncthreads();
    if (levels.count == 1 || threadIdx.x >= 256 / kLeaf) return;
    int parent = (blockIdx.x * (256 / kLeaf) + threadIdx.x) / 32;
    if (parent < levels.offset[2] - levels.offset[1])
        store_union(leaves[threadIdx.x], boxes, stride, levels.offset[1] + parent);
}

// Level `level` + 1 from level `level`; further threads pad it.
extern "C" __global__ void merge_boxes(
    float2* boxes,  // [3, boxes] (low, high) of each box and axis, world units: see Levels
    int count,      // N surfels
    int level       // the level to merge; its parents are written
) {
    Levels levels = Levels::of(count);
    int stride = levels.total(), at = blockIdx.x * blockDim.x + threadIdx.x;
    if (at / 32 >= levels.offset[level + 2] - levels.offset[level + 1]) return;
    Aabb box = empty_box();
    if (levels.offset[level] + at < levels.offset[level + 1])
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            float2 pair = boxes[long(k) * stride + levels.offset[level] + at];
            box.low[k] = pair.x, box.high[k] = pair.y;
        }
    store_union(box, boxes, stride, levels.offset[level + 1] + at / 32);
}
