// Draws: a thread some pixels, or eight that share them (see tile_primitives.cuh). For color alone the planes from
// depth on, hits, indices and weights are null.
#include "tile_primitives.cuh"

using namespace envgs;

extern "C" __global__ void __launch_bounds__(kThreads)
    draw_tiles(const uint2* ranges,                 // [tiles] first and past-the-last instance
               const u32* instance_slots,           // [instances] slot of the primitive, sorted by tile, then depth
               const VisiblePrimitive* primitives,  // [visible] by slot
               const Outline* outlines,             // [visible] by slot, pixels
               const PinholeCamera* camera_at,      // [1]
               int tiles_x,                         // tiles in a row of the image
               float transmittance_min,             // a pixel is finished below this
               const float* background,             // [3] in [0, 1]
               const Counters* counters,            // [1]
               float* color,                        // [3, P] blended color, 1 is white
               float* alpha,                        // [P] in [0, 1]
               float* depth,                        // [P] expected camera-frame z, 0 where nothing is hit
               float* normal,                       // [3, P] world frame, blended, not normalized
               float* extras,                       // [E, P] blended extras
               int* hit_counts,                     // [P] hits blended
               const int* indices,                  // [visible] by slot: the primitive's index
               float* weights                       // [N] sums of the blending weights, zeroed before
    ) {
    const PinholeCamera& camera = *camera_at;
    Place place = Place::own();
    OwnPixels own(camera, place, tiles_x);
    BlendedPixel blended[kPixels];
#pragma unroll
    for (int k = 0; k < kPixels; ++k) blended[k] = BlendedPixel::initial();
    TileList list(ranges, instance_slots, primitives, outlines, indices, place.tile, tiles_x);
    auto visit = [&](const VisiblePrimitive& p, u32 index) {
        Kind::Response at[kPixels];
        bool hits[kPixels], hit = own.hit(p.splat, at, hits);
        if (!kColorAlone && !__any_sync(kFullWarp, hit)) return;
        float sum = 0.0f;
#pragma unroll
        for (int k = 0; k < kPixels; ++k) {
            if (hits[k]) {
                float a = response_alpha(p.splat.opacity, at[k].rho), weight = blended[k].transmittance * a;
                p.blend_into(blended[k], weight, at[k]);
                blended[k].transmittance *= 1.0f - a;
                sum += weight;
            }
            own.goes_on(k, own.lives[k] && blended[k].transmittance >= transmittance_min);
        }
        if constexpr (!kColorAlone) {
            float total = warp_sum_of_weights<kPixels>(sum);
            if (lane_id() == 0) atomicAdd(weights + index, total);
        }
    };
    if constexpr (kSharedArea) {
        __shared__ float finished_at[kPixels][32];
        __shared__ BlendedPixel whole[kPixels][32];
        Progress progress[kPixels];
#pragma unroll
        for (int k = 0; k < kPixels; ++k) progress[k] = {own.lives[k] ? 1.0f : 0.0f, 0.0f};
        list.share(
            place.area, transmittance_min, progress,
            [&](const VisiblePrimitive& p, Progress(&through)[kPixels]) {
#pragma unroll
                for (int k = 0; k < kPixels; ++k) {
                    auto at = own.response(p.splat, k);
                    if (at.rho <= p.splat.support)
                        through[k].transmittance *= 1.0f - response_alpha(p.splat.opacity, at.rho);
                }
            },
            [&](int k, Progress before) {
                blended[k].transmittance = before.transmittance;
                own.goes_on(k, before.transmittance >= transmittance_min);
            },
            own.live, visit,
            [&](int k, bool finished) {
                if (finished) finished_at[k][lane_id()] = blended[k].transmittance;
            });
        for (int warp = 0; warp < kWarps; ++warp) {
            __syncthreads();
            if (warp != warp_id()) continue;
#pragma unroll
            for (int k = 0; k < kPixels; ++k) {
                if (warp > 0) blended[k].join(whole[k][lane_id()]);
                whole[k][lane_id()] = blended[k];
            }
        }
        if (warp_id() != kWarps - 1) return;
#pragma unroll
        for (int k = 0; k < kPixels; ++k) {
            bool finished = progress[k].transmittance < transmittance_min;
            blended[k].transmittance = finished ? finished_at[k][lane_id()] : progress[k].transmittance;
        }
    } else {
        list.walk(own.live, visit);
    }
    // Too little room for the instances, seen only after the fact: an image that cannot be mistaken for the right one.
    bool incomplete = counters->instances > counters->drawn_instances;
    Planes<float> out = {color, alpha, depth, normal, extras, long(camera.width) * camera.height};
#pragma unroll
    for (int k = 0; k < kPixels; ++k) {
        const Pixel& pixel = own.pixels[k];
        if (!pixel.inside) continue;
        if (incomplete) blended[k].transmittance = __int_as_float(0x7fc00000);
        blended[k].store(out, hit_counts, pixel.at, load3(background));
    }
}
