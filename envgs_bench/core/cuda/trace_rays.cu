// Traces: a warp a packet of rays. Hits are found (packet.cuh), then blended nearest first: the threads of a warp share
// the packet's rays, and blend as many hits of a ray at a time. For color alone the same, but nothing else is added up.
#include "packet.cuh"

using namespace envgs;

constexpr int kBlocks = 32;                 // at a time on a multiprocessor
constexpr int kThreadsPerRay = 32 / kRays;  // threads a ray; thread l works for ray l % kRays

// Products over a ray's threads: of those before this one.
ENVGS_FN float exclusive_product(float factor) {
    float through = factor;
#pragma unroll
    for (int offset = kRays; offset < 32; offset *= 2) {
        float below = __shfl_up_sync(kFullWarp, through, offset);
        if (lane_id() >= offset) through *= below;
    }
    float before = __shfl_up_sync(kFullWarp, through, kRays);
    return lane_id() < kRays ? 1.0f : before;
}

template <class T>
ENVGS_FN T sum_over_ray(T value) {
#pragma unroll
    for (int offset = kRays; offset < 32; offset *= 2) value += __shfl_xor_sync(kFullWarp, value, offset);
    return value;
}

ENVGS_FN Vec3<float> sum_over_ray(Vec3<float> v) { return {sum_over_ray(v.x), sum_over_ray(v.y), sum_over_ray(v.z)}; }

// What a ray blends, each of its threads a part of it until they join.
template <bool ColorAlone>
struct Blended;

template <>
struct Blended<false> {
    BlendedPixel pixel;

    ENVGS_FN static Blended initial() { return {BlendedPixel::initial()}; }
    ENVGS_FN void add(float weight, const TracedSurfel& s, const PlaneHit<float>& hit, Vec3<float> color,
                      const float* extras) {
        pixel.add(weight, color, hit.t, hit.d_z < 0.0f ? 1.0f : -1.0f, s.frame.n, extras);
    }
    ENVGS_FN void join_threads() {
        BlendedSums<float>& sums = pixel.sums;
        sums.color = sum_over_ray(sums.color), sums.normal = sum_over_ray(sums.normal);
        sums.depth = sum_over_ray(sums.depth);
#pragma unroll
        for (int e = 0; e < kExtras; ++e) pixel.extras[e] = sum_over_ray(pixel.extras[e]);
        pixel.hits = sum_over_ray(pixel.hits);
    }
    ENVGS_FN void store(const Planes<float>& out, int* hit_counts, long at, float transmittance,
                        Vec3<float> background) {
        pixel.transmittance = transmittance;
        pixel.store(out, hit_counts, at, background);
    }
};

template <>
struct Blended<true> {
    Vec3<float> color;

    ENVGS_FN static Blended initial() { return {}; }
    ENVGS_FN void add(float weight, const TracedSurfel&, const PlaneHit<float>&, Vec3<float> own, const float*) {
        color = color + weight * own;
    }
    ENVGS_FN void join_threads() { color = sum_over_ray(color); }
    ENVGS_FN void store(const Planes<float>& out, int*, long at, float transmittance, Vec3<float> background) const {
        write_color(out, at, color, transmittance, background);
    }
};

// The pages of a packet as they fill.
struct PageWriter {
    Pages pages;
    int first = -1, page = -1, rows = 0;

    // Makes room for `kShares` more rows and returns where they begin, or null where there is no room.
    __device__ u32* more_rows() {
        if (kColorAlone || pages.capacity == 0) return nullptr;
        int row = rows % kPageRows;
        if (row == 0) {
            int taken = lane_id() == 0 ? atomicAdd(pages.used, 1) : 0;
            taken = __shfl_sync(kFullWarp, taken, 0);
            if (taken >= pages.capacity) taken = -1;
            if (rows == 0) first = taken;
            if (lane_id() == 0 && page >= 0) pages.next[page] = taken;
            page = taken;
        }
        rows += kThreadsPerRay;
        return page < 0 ? nullptr : pages.slots + (long(page) * kPageRows + row) * kRays;
    }
};

extern "C" __global__ void __launch_bounds__(32, kBlocks)
    trace_rays(const float* origins,                 // [R, 3] world units
               const float* directions,              // [R, 3] world frame, any length; zero hits nothing
               const u32* order,                     // [R] indices of rays; packets take eight in this order
               int rays,                             // R
               float4* packed_surfels,               // [leaves, 3, kLeaf] see PackedSurfels
               const PackedAppearance* appearances,  // [N] by slot
               const float2* boxes,  // [3, boxes] (low, high) of each box and axis, world units: see Levels
               int surfel_count,     // N
               const CenterStatistics* statistics,  // [1] extent of the surfels' centers
               float t_min,                         // hits at smaller t are not drawn
               const float* transmittance_min,      // [R] a ray ends below this
               const float* background,             // [3] in [0, 1]
               float* color,                        // [3, R] blended color, 1 is white
               float* alpha,                        // [R] in [0, 1]
               // Null from here on where color is drawn alone:
               float* depth,      // [R] expected t in units of |direction|, 0 where nothing is hit
               float* normal,     // [3, R] world frame, blended, not normalized
               float* extras,     // [E, R] blended extras
               int* hit_counts,   // [R] hits blended
               float* weights,    // [N] sums of the blending weights, zeroed before
               u32* page_slots,   // [page_capacity, kPageRows, kRays] slots of hits, kNoHit where a ray has none
               int* page_next,    // [page_capacity] the page that follows; −1: none
               int2* page_heads,  // [packets] first page, number of rows
               u32* pages_used,   // [1] pages asked for; above page_capacity hits were lost
               u32 page_capacity  // pages there is room for; 0: hits are not kept
    ) {
    __shared__ PacketMemory memory;
    __shared__ Blended<kColorAlone> blended_of_rays[kRays];  // not in registers, which the search is short of
    __shared__ Levels levels;
    if (threadIdx.x == 0) levels = Levels::of(surfel_count);
    __syncwarp();
    PackedSurfels surfels = {packed_surfels};
    PageWriter writer = {{page_slots, page_next, page_heads, pages_used, page_capacity}};
    int thread_of_ray = lane_id() / kRays;
    Ray ray = ordered_ray(origins, directions, order, rays, long(blockIdx.x) * kRays + lane_id() % kRays);
    int index = ray.index;
    const RayState& own = memory.rays[lane_id() % kRays];
    Extent extent(*statistics);
    float max_origin_distance = kGroupOriginDistance * maximum(extent.size.x, maximum(extent.size.y, extent.size.z));
    Packet packet(memory, levels, boxes, surfels, ray, t_min, index < 0 ? 1.0f : transmittance_min[index],
                  max_origin_distance);
    if (thread_of_ray == 0) blended_of_rays[lane_id()] = Blended<kColorAlone>::initial();
    float transmittance = 1.0f;
    bool wanted = index >= 0;
    // Rounds of a search and a blending, until every ray of the packet has ended.
    while (__any_sync(kFullWarp, wanted)) {
        // Search: each ray's nearest hits that were not blended yet, front to back.
        packet.search(wanted, transmittance);
        // Blend: as many hits of a ray at a time as it has threads.
        bool ended = !wanted;
        int blended = 0;
        Blended<kColorAlone> part = Blended<kColorAlone>::initial();
        if (thread_of_ray == 0) part = blended_of_rays[lane_id()];
        for (int first = 0; __any_sync(kFullWarp, !ended && first < packet.count()); first += kThreadsPerRay) {
            int k = first + thread_of_ray;
            bool listed = !ended && k < packet.count();
            u32 slot = listed ? packet.slot(k) : 0;
            // Intersect: each thread its own hit.
            TracedSurfel s;
            PlaneHit<float> hit;
            float a = 0.0f;
            if (listed) {
                s = surfels.load(slot);
                hit = intersect(s.frame, own.origin - s.mean, own.direction);
                a = response_alpha(s.opacity, hit.u * hit.u + hit.v * hit.v);
            }
            // Weigh: by what the hits before leave of the ray.
            float before = transmittance * exclusive_product(1.0f - a);
            bool blends = listed && before >= own.transmittance_min;
            if (blends) {
                Appearance appearance(appearances[slot]);
                Vec3<float> v = kShAlongRay ? own.direction : s.mean - own.origin;
                part.add(before * a, s, hit, seen_color(appearance.sh, v), appearance.extras);
                if constexpr (!kColorAlone) atomicAdd(weights + s.index, before * a);
            }
            // Keep: the hits, for the backward pass.
            u32* rows = writer.more_rows();
            if (rows) rows[lane_id()] = blends ? slot : kNoHit;
            // Advance: past the ray's threads that blended, always the first ones.
            u32 threads = __ballot_sync(kFullWarp, blends) >> lane_id() % kRays;
            int count = 0;
#pragma unroll
            for (int other = 0; other < kThreadsPerRay; ++other) count += threads >> other * kRays & 1;
            float after = __shfl_sync(kFullWarp, before * (1.0f - a), max(count - 1, 0) * kRays + lane_id() % kRays);
            if (count) transmittance = after;
            blended += count;
            ended = ended || !(transmittance >= own.transmittance_min);  // NaN ends it, too
        }
        // Resume: behind the last hit that was blended, where the list had no room for all.
        part.join_threads();
        if (thread_of_ray == 0) blended_of_rays[lane_id()] = part;
        wanted = wanted && !ended && packet.dropped();
        packet.resume_after(wanted ? blended - 1 : -1);
    }
    // Store: a ray's first thread its sums.
    if (writer.pages.capacity && lane_id() == 0) page_heads[blockIdx.x] = make_int2(writer.first, writer.rows);
    if (thread_of_ray > 0 || index < 0) return;
    Planes<float> out = {color, alpha, depth, normal, extras, rays};
    blended_of_rays[lane_id()].store(out, hit_counts, index, transmittance, load3(background));
}
