// Differentiates: each ray's hits once more, from the pages that the forward pass kept, front to back (see blend.h).
#include "trace.cuh"

using namespace envgs;

ENVGS_FN void add_four(float* to, const float* four) {
#if __CUDA_ARCH__ >= 900
    asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(to), "f"(four[0]), "f"(four[1]), "f"(four[2]),
                 "f"(four[3])
                 : "memory");
#else
    for (int k = 0; k < 4; ++k) atomicAdd(to + k, four[k]);
#endif
}

extern "C" __global__ void __launch_bounds__(128)
    differentiate_rays(const float* origins, const float* directions, const u32* order, int rays,
                       float4* quarters, const Appearance* appearances, const float* background,
                       const float* color, const float* alpha, const float* depth, const float* normal,
                       const float* extras, const float* g_color, const float* g_alpha, const float* g_depth,
                       const float* g_normal, const float* g_extras, const u32* page_slots, const int* page_next,
                       const int2* page_heads, const u32* pages_used, u32 page_capacity, float* sums,
                       float* g_origins, float* g_directions) {
    long place = long(blockIdx.x) * blockDim.x + threadIdx.x;
    if (place >= rays) return;
    Surfels surfels = {quarters};
    Ray ray = ordered_ray(origins, directions, order, rays, place);
    long at = ray.index;
    Planes<const float> out = {color, alpha, depth, normal, extras, rays};
    Planes<const float> gradient = {g_color, g_alpha, g_depth, g_normal, g_extras, rays};
    Upstream g(out, gradient, at, load3(background));
    // Hits were lost for want of pages: gradients that cannot be mistaken for the right ones.
    if (*pages_used > page_capacity) g.transmittance = __int_as_float(0x7fc00000);
    Vec3<float> g_origin = {0.0f, 0.0f, 0.0f}, g_direction = {0.0f, 0.0f, 0.0f};
    int2 head = page_heads[place / kRays];
    for (int page = head.x, rows = head.y; rows > 0 && page >= 0; rows -= kPageRows) {
        const u32* slots = page_slots + long(page) * kPageRows * kRays + place % kRays;
        u32 following = slots[0];
        for (int k = 0; k < min(rows, kPageRows); ++k) {
            u32 slot = following;
            if (k + 1 < min(rows, kPageRows)) following = slots[(k + 1) * kRays];  // while this hit is worked on
            if (slot == kNoHit) continue;
            TracedSurfel s = surfels.load(slot);
            Appearance look = appearances[slot];
            PlaneHit<float> hit = intersect(s.frame, ray.origin - s.mean, ray.direction);
            float a = response_alpha(s.opacity, hit.u * hit.u + hit.v * hit.v);
            float side = hit.d_z < 0.0f ? 1.0f : -1.0f;
            Vec3<float> v = s.mean - ray.origin;
            Vec3<float> c = sh_color<kShDegree>(look.values, v);
            float weight = g.transmittance * a;
            float value = g.value(c, hit.t, side * s.frame.n, look.values + kShFloats);
            AlphaGradient<float> own = alpha_backward(s.opacity, a, blend_backward(a, value, g.transmittance, g.remaining));
            Vec3<float> local = intersect_backward(hit, dot(s.frame.u, ray.direction), dot(s.frame.v, ray.direction),
                                                   weight * g.sum.depth, 2.0f * own.rho * hit.u,
                                                   2.0f * own.rho * hit.v);
            float sum[kTraceSums] = {};
            SurfelMoments<float> moments = {};
            add_hit(moments, hit, local);
            store3(sum, moments.g), store3(sum + 3, moments.g_u), store3(sum + 6, moments.g_v);
            store3(sum + 9, moments.traveled);
            store3(sum + kNormalSum, (side * weight) * g.sum.normal);
            sum[kOpacitySum] = own.opacity;
            Vec3<float> g_v = sh_color_backward<kShDegree>(look.values, v, c, weight * g.sum.color, sum + kShSums);
            store3(sum + kDirectionSum, g_v);
#pragma unroll
            for (int e = 0; e < kExtras; ++e) sum[kShSums + kShFloats + e] = weight * g.extras[e];
            float* to = sums + long(kTraceSums) * s.index;
#pragma unroll
            for (int four = 0; four < kTraceSums; four += 4) add_four(to + four, sum + four);

            Vec3<float> world = local.x * s.frame.u + local.y * s.frame.v + local.z * s.frame.n;
            g_origin = g_origin + world - g_v;
            g_direction = g_direction + hit.t * world;
        }
        if (rows > kPageRows) page = page_next[page];
    }
    store3(g_origins + 3 * at, g_origin);
    store3(g_directions + 3 * at, g_direction);
}
