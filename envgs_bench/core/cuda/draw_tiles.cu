// Draws: a block a tile, a thread a pixel.
#include "tile_primitives.cuh"

using namespace envgs;

extern "C" __global__ void __launch_bounds__(256)
    draw_tiles(const uint2* ranges, const u32* instance_slots, const VisiblePrimitive* primitives, const Outline* outlines,
               const PinholeCamera* camera_at, int tiles_x, float transmittance_min, const float* background,
               const Counters* counters, float* color, float* alpha, float* depth, float* normal, float* extras,
               int* hit_counts, const int* indices, float* weights) {
    const PinholeCamera& camera = *camera_at;
    Pixel pixel = own_pixel(camera, blockIdx.x, tiles_x);
    float x = pixel.x + 0.5f, y = pixel.y + 0.5f, near = camera.near;
    BlendedSums sums = BlendedSums::initial();
    bool live = pixel.inside;
    for_each_primitive(ranges[blockIdx.x], instance_slots, primitives, outlines, blockIdx.x % tiles_x * kTile,
              blockIdx.x / tiles_x * kTile, live, [&](const VisiblePrimitive& p, u32 slot) {
                  auto at = evaluate(p.splat, x, y, near);
                  bool hit = live && at.rho <= p.splat.support;
                  if (!__any_sync(kFullWarp, hit)) return;
                  float weight = 0.0f;
                  if (hit) {
                      float a = response_alpha(p.splat.opacity, at.rho);
                      weight = sums.transmittance * a;
                      sums.add(weight, p.color, at.t, at.side * p.normal, p.extras);
                      sums.transmittance *= 1.0f - a;
                      live = sums.transmittance >= transmittance_min;
                  }
                  float total = warp_sum_of_weights(weight);
                  if (lane_id() == 0) atomicAdd(weights + indices[slot], total);
              });
    if (!pixel.inside) return;
    // Too little room for the instances, seen only after the fact: an image that cannot be mistaken for the right one.
    if (counters->instances > counters->drawn_instances) sums.transmittance = __int_as_float(0x7fc00000);
    Planes<float> out = {color, alpha, depth, normal, extras, long(camera.width) * camera.height};
    sums.store(out, hit_counts, pixel.at, load3(background));
}
