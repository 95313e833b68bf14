// Traces: a warp a packet of 32 rays. Hits are found (packet.cuh), then blended nearest first, a thread a ray.
#include "packet.cuh"

using namespace envgs;

constexpr int kWarps = 2;

extern "C" __global__ void __launch_bounds__(32 * kWarps)
    trace_rays(const float* origins, const float* directions, const u32* order, int rays, const TracedSurfel* surfels,
               const Appearance* appearances, const float* boxes, int surfel_count, const CentreStatistics* statistics,
               float t_min, float transmittance_min, const float* background, float* color, float* alpha, float* depth,
               float* normal, float* extras, int* hit_counts, float* weights, u32* page_slots, int* page_next,
               int2* page_heads, u32* pages_used, u32 page_capacity) {
    __shared__ PacketMemory memory[kWarps];
    __shared__ Levels levels;
    if (threadIdx.x == 0) levels = Levels::of(surfel_count);
    __syncthreads();
    int packet_index = blockIdx.x * kWarps + warp_id();
    if (packet_index * 32l >= rays) return;
    Pages pages = {page_slots, page_next, page_heads, pages_used, page_capacity};
    Ray ray = own_ray(origins, directions, order, rays, packet_index);
    Extent extent(*statistics);
    float reach = kGroupReach * maximum(extent.size.x, maximum(extent.size.y, extent.size.z));
    Packet packet(memory[warp_id()], levels, boxes, surfels, ray, t_min, reach);
    Blended sums;
    bool wanted = ray.index >= 0;
    int first_page = -1, page = -1, listed = 0;
    while (__any_sync(kFullWarp, wanted)) {
        packet.search(wanted, sums.transmittance, transmittance_min);
        wanted = wanted && packet.count() > 0;
        bool ended = !wanted;
        float t = 0.0f;
        u32 slot = 0;
        for (int k = 0; __any_sync(kFullWarp, !ended && k < packet.count()); ++k, ++listed) {
            if (pages.capacity && listed % kPageHits == 0) {
                int taken = lane_id() == 0 ? atomicAdd(pages.used, 1) : 0;
                taken = __shfl_sync(kFullWarp, taken, 0);
                if (taken >= pages.capacity) taken = -1;
                if (listed == 0) first_page = taken;
                if (lane_id() == 0 && page >= 0) pages.next[page] = taken;
                page = taken;
            }
            bool blends = !ended && k < packet.count();
            if (blends) {
                t = packet.t(k), slot = packet.slot(k);
                TracedSurfel s = surfels[slot];
                Appearance look = appearances[slot];
                PlaneHit<float> hit = intersect(s.frame, ray.origin - s.mean, ray.direction);
                float a = response_alpha(s.opacity, hit.u * hit.u + hit.v * hit.v);
                float weight = sums.transmittance * a;
                Vec3<float> c = sh_color<kShDegree>(look.values, s.mean - ray.origin);
                sums.add(weight, c, t, (hit.d_z < 0.0f ? 1.0f : -1.0f) * s.frame.n, look.values + kShFloats);
                sums.transmittance *= 1.0f - a;
                atomicAdd(weights + s.index, weight);
                ended = sums.transmittance < transmittance_min;
            }
            if (page >= 0) pages.slots[(long(page) * kPageHits + listed % kPageHits) * 32 + lane_id()] = blends ? slot : ~0u;
        }
        wanted = wanted && !ended && packet.dropped();
        if (wanted) packet.resume_after(t, slot);
    }
    if (pages.capacity && lane_id() == 0) pages.heads[packet_index] = make_int2(first_page, listed);
    Planes<float> out = {color, alpha, depth, normal, extras, rays};
    if (ray.index >= 0) sums.store(out, hit_counts, ray.index, load3(background));
}
