// Differentiates trace_rays: each ray's hits once more, front to back (see blend.h), from the pages that trace_rays
// kept.
#include "trace.cuh"

using namespace envgs;

constexpr bool kRemovals = REMOVALS;  // sums of removal_square in place of dL/dopacity

ENVGS_FN void atomic_add4(float* to, float4 value4) {
#if __CUDA_ARCH__ >= 900
    asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(to), "f"(value4.x), "f"(value4.y), "f"(value4.z),
                 "f"(value4.w)
                 : "memory");
#else
    atomicAdd(to, value4.x), atomicAdd(to + 1, value4.y), atomicAdd(to + 2, value4.z), atomicAdd(to + 3, value4.w);
#endif
}

// What one hit of each of a warp's rays adds: a row a thread, in shared memory. Neighboring rays hit the same surfels,
// whose rows are added up here and leave in one piece: a team of threads takes a surfel, a thread four columns.
struct WarpRows {
    static constexpr int kFloat4s = kTraceSums / 4;
    static constexpr int kTeam = kFloat4s <= 8 ? 8 : kFloat4s <= 16 ? 16 : 32;  // threads
    static constexpr int kStride = kFloat4s | 1;  // odd: eight rows' float4s fall on different banks

    float4 values4[32][kStride];

    // The whole warp. Rows of threads whose `surfel` is negative do not count.
    __device__ __forceinline__ void add_to(float* sums, int surfel) {
        int column = lane_id() % kTeam, team = lane_id() / kTeam;
        __syncwarp();
        u32 same_surfel = __match_any_sync(kFullWarp, surfel);
        u32 firsts = __ballot_sync(kFullWarp, surfel >= 0 && lane_id() == __ffs(same_surfel) - 1);
        while (firsts) {
            int first = 0;
            bool active = false;
#pragma unroll
            for (int t = 0; t < 32 / kTeam; ++t) {  // the next surfels, one a team
                if (t == team && firsts) first = __ffs(firsts) - 1, active = column < kFloat4s;
                firsts &= firsts - 1;
            }
            u32 group = __shfl_sync(kFullWarp, same_surfel, first);
            int to = __shfl_sync(kFullWarp, surfel, first);
            float4 sum = {0.0f, 0.0f, 0.0f, 0.0f};
            for (group = active ? group : 0; group; group &= group - 1) {
                float4 value4 = values4[__ffs(group) - 1][column];
                sum.x += value4.x, sum.y += value4.y, sum.z += value4.z, sum.w += value4.w;
            }
            if (active) atomic_add4(sums + long(kTraceSums) * to + 4 * column, sum);
        }
        __syncwarp();
    }
};

extern "C" __global__ void __launch_bounds__(128) differentiate_rays(
    const float* origins,                 // [R, 3] world units
    const float* directions,              // [R, 3] world frame, any length; zero hits nothing
    const u32* order,                     // [R] indices of rays; packets take eight in this order
    int rays,                             // R
    float4* packed_surfels,               // [leaves, 3, kLeaf] see PackedSurfels
    const PackedAppearance* appearances,  // [N] by slot
    const float* background,              // [3] in [0, 1]
    const float* color,                   // [3, R] blended color, 1 is white
    const float* alpha,                   // [R] in [0, 1]
    const float* depth,                   // [R] expected t in units of |direction|, 0 where nothing is hit
    const float* normal,                  // [3, R] world frame, blended, not normalized
    const float* extras,                  // [E, R] blended extras
    const float* g_color,                 // [3, R] dL/dcolor, null for zero
    const float* g_alpha,                 // [R] dL/dalpha, null for zero
    const float* g_depth,                 // [R] dL/ddepth, null for zero
    const float* g_normal,                // [3, R] dL/dnormal, null for zero
    const float* g_extras,                // [E, R] dL/dextras, null for zero
    const u32* page_slots,   // [page_capacity, kPageRows, kRays] slots of hits, kNoHit where a ray has none
    const int* page_next,    // [page_capacity] the page that follows; −1: none
    const int2* page_heads,  // [packets] first page, number of rows
    const u32* pages_used,   // [1] pages asked for; above page_capacity hits were lost
    u32 page_capacity,       // pages there is room for; 0: hits are not kept
    float* sums,             // [N, kTraceSums] by index, zeroed before
    float* g_origins,        // [R, 3] dL/dorigins
    float* g_directions      // [R, 3] dL/ddirections
) {
    __shared__ WarpRows rows_of_warps[128 / 32];
    WarpRows& rows_of_warp = rows_of_warps[warp_id()];
    long place = long(blockIdx.x) * blockDim.x + threadIdx.x;
    bool exists = place < rays;
    PackedSurfels surfels = {packed_surfels};
    Ray ray = ordered_ray(origins, directions, order, rays, place);
    long at = exists ? ray.index : 0;
    Planes<const float> out = {color, alpha, depth, normal, extras, rays};
    Planes<const float> gradient = {g_color, g_alpha, g_depth, g_normal, g_extras, rays};
    UpstreamGradient g(out, gradient, at, load3(background));
    // Hits were lost for want of pages: gradients that cannot be mistaken for the right ones.
    if (*pages_used > page_capacity) g.transmittance = __int_as_float(0x7fc00000);
    Vec3<float> g_origin = {0.0f, 0.0f, 0.0f}, g_direction = {0.0f, 0.0f, 0.0f};
    int2 head = exists ? page_heads[place / kRays] : make_int2(-1, 0);
    int page = head.x, rows = page >= 0 ? head.y : 0;
    auto slot_of = [&](int row) {
        if (row > 0 && row < rows && row % kPageRows == 0) {
            page = page_next[page];
            if (page < 0) rows = 0;
        }
        return row < rows ? page_slots[(long(page) * kPageRows + row % kPageRows) * kRays + place % kRays] : kNoHit;
    };
    u32 following = slot_of(0);
    int most = __reduce_max_sync(kFullWarp, u32(rows));
    for (int row = 0; row < most; ++row) {
        u32 slot = following;
        following = slot_of(row + 1);  // while this hit is worked on
        int index = -1;
        if (slot != kNoHit) {
            TracedSurfel s = surfels.load(slot);
            Appearance appearance(appearances[slot]);
            PlaneHit<float> hit = intersect(s.frame, ray.origin - s.mean, ray.direction);
            float a = response_alpha(s.opacity, hit.u * hit.u + hit.v * hit.v);
            float side = hit.d_z < 0.0f ? 1.0f : -1.0f;
            Vec3<float> v = kShAlongRay ? ray.direction : s.mean - ray.origin;
            Vec3<float> c = seen_color(appearance.sh, v);
            auto [weight, g_a] = g.hit(a, c, hit.t, side, s.frame.n, appearance.extras);
            AlphaGradient<float> own = alpha_backward(s.opacity, a, g_a);
            Vec3<float> local =
                intersect_backward(hit, dot(s.frame.u, ray.direction), dot(s.frame.v, ray.direction),
                                   weight * g.sum.depth, 2.0f * own.rho * hit.u, 2.0f * own.rho * hit.v);
            float sum[kTraceSums] = {};
            SurfelMoments<float> moments = {};
            add_hit(moments, hit, local);
            store3(sum, moments.g), store3(sum + 3, moments.g_u), store3(sum + 6, moments.g_v);
            store3(sum + 9, moments.g_t);
            store3(sum + kNormalSum, (side * weight) * g.sum.normal);
            sum[kOpacitySum] = kRemovals ? removal_square(a, g_a) : own.opacity;
            Vec3<float> g_v = seen_color_backward(appearance.sh, v, c, weight * g.sum.color, sum + kShSums);
            if constexpr (!kShAlongRay) store3(sum + kDirectionSum, g_v);
#pragma unroll
            for (int e = 0; e < kExtras; ++e) sum[kShSums + kShFloats + e] = weight * g.extras[e];
            index = s.index;
#pragma unroll
            for (int k = 0; k < WarpRows::kFloat4s; ++k)
                rows_of_warp.values4[lane_id()][k] =
                    make_float4(sum[4 * k], sum[4 * k + 1], sum[4 * k + 2], sum[4 * k + 3]);

            Vec3<float> world = local.x * s.frame.u + local.y * s.frame.v + local.z * s.frame.n;
            g_origin = g_origin + world;
            g_direction = g_direction + hit.t * world;
            if constexpr (kShAlongRay)
                g_direction = g_direction + g_v;
            else
                g_origin = g_origin - g_v;
        }
        rows_of_warp.add_to(sums, index);
    }
    if (!exists) return;
    store3(g_origins + 3 * at, g_origin);
    store3(g_directions + 3 * at, g_direction);
}
