#include "trace.h"

#include <algorithm>

#include "parallel.h"
#include "traversal.h"

namespace envgs {

namespace {

constexpr int kChunk = 64;  // rays that one thread takes at a time
constexpr int kGroup = 8;   // hits that the backward pass differentiates at a time

Vec3<float> ray_at(const float* rays, int ray) { return load3(rays + 3l * ray); }

}  // namespace

// What one worker sums up for a surfel, besides SH and extras.
struct TracePass::TracedSurfelSums {
    SurfelMoments<float> moments;
    Vec3<float> normal;
    float opacity;
    Vec3<float> color_direction;  // dL/dmean by way of the direction that the color is seen from
};

struct TracePass::Worker {
    std::vector<TracedSurfelSums> sums;
    std::vector<float> sh, extras;
};

TracePass::TracePass(std::shared_ptr<const Bvh> bvh, const Gaussians& gaussians, const RayBatch& rays,
                     Vec3<float> background, float t_min, float transmittance_min, bool sh_along_ray, int threads)
    : bvh_(std::move(bvh)), g_(gaussians), rays_(rays), background_(background), t_min_(t_min),
      transmittance_min_(transmittance_min), sh_along_ray_(sh_along_ray), threads_(threads) {}

int TracePass::chunks() const { return (rays_.count + kChunk - 1) / kChunk; }

void TracePass::forward(Planes<float> out, int* hits, float* weights, bool keep_hits) {
    chunk_hits_.assign(keep_hits ? chunks() : 0, {});
    hit_counts_.assign(keep_hits ? rays_.count : 0, 0);
    long n = rays_.count;
    std::vector<std::vector<float>> partial(threads_);
    parallel(threads_, [&](int worker) {
        partial[worker].assign(g_.count, 0.0f);
        Traversal traversal(*bvh_);
        for (int chunk = worker; chunk < chunks(); chunk += threads_)
            for (int ray = chunk * kChunk; ray < std::min((chunk + 1) * kChunk, rays_.count); ++ray) {
                Vec3<float> origin = ray_at(rays_.origins, ray), direction = ray_at(rays_.directions, ray);
                const std::vector<Hit>& found = traversal.hits(origin, direction, t_min_, transmittance_min_);
                Vec3<float> color = {0, 0, 0}, normal = {0, 0, 0};
                float transmittance = 1.0f, depth = 0.0f, extras[8] = {};
                for (const Hit& hit : found) {
                    int i = hit.index();
                    const TracedSurfel& s = bvh_->surfels[i];
                    float weight = transmittance * hit.alpha;
                    transmittance *= 1.0f - hit.alpha;
                    color = color + weight * color_at(g_, i, sh_along_ray_ ? direction : s.mean - origin);
                    normal = normal + (dot(s.frame.n, direction) < 0.0f ? weight : -weight) * s.frame.n;
                    depth += weight * hit.t();
                    for (int e = 0; e < g_.extra_count; ++e) extras[e] += weight * g_.extras[g_.extra_count * i + e];
                    partial[worker][i] += weight;
                    if (keep_hits) chunk_hits_[chunk].push_back(i);
                }
                if (keep_hits) hit_counts_[ray] = int(found.size());
                color = color + transmittance * background_;
                float alpha = 1.0f - transmittance;
                out.color[ray] = color.x, out.color[n + ray] = color.y, out.color[2 * n + ray] = color.z;
                out.normal[ray] = normal.x, out.normal[n + ray] = normal.y, out.normal[2 * n + ray] = normal.z;
                out.alpha[ray] = alpha;
                out.depth[ray] = alpha > 0.0f ? depth / alpha : 0.0f;
                for (int e = 0; e < g_.extra_count; ++e) out.extras[e * n + ray] = extras[e];
                hits[ray] = int(found.size());
            }
    });
    std::fill(weights, weights + g_.count, 0.0f);
    for (const auto& part : partial)
        for (int i = 0; i < g_.count; ++i) weights[i] += part[i];
}

void TracePass::differentiate_ray(int ray, const int* hits, int count, Planes<const float> out,
                                  Planes<const float> gradient, TracedSurfelSums* sums, float* g_sh, float* g_extras,
                                  RayGradients rays) const {
    long n = rays_.count;
    auto read = [](const float* plane, long at) { return plane ? plane[at] : 0.0f; };
    auto read3 = [&](const float* plane) -> Vec3<float> {
        return {read(plane, ray), read(plane, plane ? n + ray : 0), read(plane, plane ? 2 * n + ray : 0)};
    };
    Vec3<float> origin = ray_at(rays_.origins, ray), direction = ray_at(rays_.directions, ray);
    float final_alpha = out.alpha[ray], depth = out.depth[ray];
    SumGradient<float> g = sum_gradient(read3(gradient.color), read(gradient.alpha, ray), read(gradient.depth, ray),
                                        read3(gradient.normal), final_alpha, depth, background_);
    float remaining = blended_total(g, read3(out.color), final_alpha, depth, read3(out.normal), background_);
    float g_extra[8] = {};
    for (int e = 0; e < g_.extra_count; ++e) {
        g_extra[e] = read(gradient.extras, e * n + ray);
        remaining += g_extra[e] * out.extras[e * n + ray];
    }
    float transmittance = 1.0f;
    Vec3<float> g_origin = {0, 0, 0}, g_direction = {0, 0, 0};
    Vec3<Float8> o = {Float8{} + origin.x, Float8{} + origin.y, Float8{} + origin.z};
    Vec3<Float8> d = {Float8{} + direction.x, Float8{} + direction.y, Float8{} + direction.z};

    for (int begin = 0; begin < count; begin += kGroup) {
        int group = std::min(kGroup, count - begin);
        // Eight surfels, one a lane; lanes past the end repeat the last and get no weight.
        alignas(32) float gathered[14][kGroup];
        for (int lane = 0; lane < kGroup; ++lane) {
            const float* s = &bvh_->surfels[hits[begin + std::min(lane, group - 1)]].frame.u.x;
            for (int k = 0; k < 14; ++k) gathered[k][lane] = s[k];
        }
        auto field = [&](int k) { return load_lanes<Float8>(gathered[k]); };
        SurfelFrame<Float8> frame = {{field(0), field(1), field(2)}, {field(3), field(4), field(5)},
                                     {field(6), field(7), field(8)}};
        Vec3<Float8> from_mean = o - Vec3<Float8>{field(9), field(10), field(11)};
        Float8 opacity = field(13);
        PlaneHit<Float8> hit = intersect(frame, from_mean, d);
        Float8 alpha = response_alpha(opacity, hit.u * hit.u + hit.v * hit.v);

        // Along the ray, hit after hit: colors, transmittance, dL/dα.
        alignas(32) float weight[kGroup] = {}, g_alpha[kGroup] = {};
        for (int lane = 0; lane < group; ++lane) {
            int i = hits[begin + lane];
            const TracedSurfel& s = bvh_->surfels[i];
            Vec3<float> v = sh_along_ray_ ? direction : s.mean - origin;
            Vec3<float> color = color_at(g_, i, v);
            float side = hit.d_z[lane] < 0.0f ? 1.0f : -1.0f;
            float value = dot(g.color, color) + g.depth * hit.t[lane] + side * dot(g.normal, s.frame.n) + g.weight;
            for (int e = 0; e < g_.extra_count; ++e) value += g_extra[e] * g_.extras[g_.extra_count * i + e];
            weight[lane] = transmittance * alpha[lane];
            g_alpha[lane] = blend_backward(alpha[lane], value, transmittance, remaining);

            TracedSurfelSums& sum = sums[i];
            Vec3<float> g_v = color_backward_at(g_, i, v, color, weight[lane] * g.color,
                                                g_sh + 3l * g_.sh_coefficients * i);
            if (sh_along_ray_) {
                g_direction = g_direction + g_v;
            } else {
                sum.color_direction = sum.color_direction + g_v;
                g_origin = g_origin - g_v;
            }
            sum.normal = sum.normal + (side * weight[lane]) * g.normal;
            for (int e = 0; e < g_.extra_count; ++e) g_extras[g_.extra_count * i + e] += weight[lane] * g_extra[e];
        }

        AlphaGradient<Float8> ga = alpha_backward(opacity, alpha, load_lanes<Float8>(g_alpha));
        Vec3<Float8> local = intersect_backward(hit, dot(frame.u, d), dot(frame.v, d),
                                                load_lanes<Float8>(weight) * g.depth, 2.0f * ga.rho * hit.u,
                                                2.0f * ga.rho * hit.v);
        SurfelMoments<Float8> moments = {};
        add_hit(moments, hit, local);
        const Float8* lanes = reinterpret_cast<const Float8*>(&moments);
        for (int lane = 0; lane < group; ++lane) {
            TracedSurfelSums& sum = sums[hits[begin + lane]];
            float* to = reinterpret_cast<float*>(&sum.moments);
            for (int k = 0; k < 12; ++k) to[k] += lanes[k][lane];
            sum.opacity += ga.opacity[lane];
        }
        Vec3<Float8> world = local.x * frame.u + local.y * frame.v + local.z * frame.n;
        typename LanesOf<Float8>::Int inside;
        for (int lane = 0; lane < kGroup; ++lane) inside[lane] = lane < group ? -1 : 0;
        auto total = [&](Float8 x) { return sum_lanes(select(inside, x, Float8{})); };
        g_origin = g_origin + Vec3<float>{total(world.x), total(world.y), total(world.z)};
        g_direction = g_direction + Vec3<float>{total(hit.t * world.x), total(hit.t * world.y), total(hit.t * world.z)};
    }
    store3(rays.origins + 3l * ray, g_origin);
    store3(rays.directions + 3l * ray, g_direction);
}

void TracePass::backward(Planes<const float> out, Planes<const float> gradient, GaussianGradients result,
                         RayGradients rays) {
    std::vector<Worker> workers(threads_);
    parallel(threads_, [&](int w) {
        Worker& worker = workers[w];
        worker.sums.assign(g_.count, TracedSurfelSums{});
        worker.sh.assign(3l * g_.sh_coefficients * g_.count, 0.0f);
        worker.extras.assign(long(g_.extra_count) * g_.count, 0.0f);
        for (int chunk = w; chunk < chunks(); chunk += threads_) {
            const int* hits = chunk_hits_[chunk].data();
            for (int ray = chunk * kChunk; ray < std::min((chunk + 1) * kChunk, rays_.count); ++ray) {
                differentiate_ray(ray, hits, hit_counts_[ray], out, gradient, worker.sums.data(), worker.sh.data(),
                                  worker.extras.data(), rays);
                hits += hit_counts_[ray];
            }
        }
    });
    parallel_ranges(threads_, g_.count, [&](int begin, int end, int) { finish_surfels(begin, end, workers, result); });
}

void TracePass::finish_surfels(int begin, int end, const std::vector<Worker>& workers, GaussianGradients result) const {
    constexpr int kSums = sizeof(TracedSurfelSums) / sizeof(float);
    for (int i = begin; i < end; ++i) {
        TracedSurfelSums sum = workers[0].sums[i];
        for (size_t w = 1; w < workers.size(); ++w) {
            const float* other = reinterpret_cast<const float*>(&workers[w].sums[i]);
            for (int k = 0; k < kSums; ++k) reinterpret_cast<float*>(&sum)[k] += other[k];
        }
        float inverse_norm;
        Quaternion<float> q = normalized(quaternion_at(g_, i), inverse_norm);
        SurfelGradient<float> g = surfel_backward(axes_of(q), g_.scales[2 * i], g_.scales[2 * i + 1], sum.moments,
                                                  sum.normal);
        store3(result.means + 3l * i, g.mean + sum.color_direction);
        store3(result.position_gradients + 3l * i, g.position_statistic);
        Quaternion<float> gq = quaternion_gradient(q, inverse_norm, g.torque);
        float* to = result.quaternions + 4l * i;
        to[0] = gq.w, to[1] = gq.x, to[2] = gq.y, to[3] = gq.z;
        result.scales[2l * i] = g.scale_u;
        result.scales[2l * i + 1] = g.scale_v;
        result.opacities[i] = sum.opacity;
    }
    auto add = [&](float* to, long stride, auto part) {
        for (const Worker& worker : workers)
            for (long k = stride * begin; k < stride * end; ++k) to[k] += part(worker)[k];
    };
    add(result.sh, 3l * g_.sh_coefficients, [](const Worker& w) { return w.sh.data(); });
    add(result.extras, g_.extra_count, [](const Worker& w) { return w.extras.data(); });
}

}  // namespace envgs
