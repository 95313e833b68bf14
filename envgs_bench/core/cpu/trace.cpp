#include "trace.h"

#include <algorithm>

#include "colors.h"
#include "parallel.h"
#include "traversal.h"

namespace envgs {

namespace {

constexpr int kChunk = 64;          // rays that one thread takes at a time
constexpr int kAhead = 4;           // hits between the one whose memory is asked for and the one that is blended
constexpr int kLine = 64;           // bytes of a line of the caches
constexpr int kColors = 2 * kLine;  // bytes of a hit's SH that are asked for: most of degree 2's
constexpr int kSurfelValues = count_of<SurfelValues<float>, float>, kMoments = count_of<SurfelMoments<float>, float>;

Vec3<float> ray_at(const float* rays, int ray) { return load3(rays + 3l * ray); }

// Asks for memory before it is needed: hits lie anywhere in it, and a ray knows its next ones.
template <int Bytes, int Write = 0>
void prefetch(const void* at) {
    for (int line = 0; line < Bytes; line += kLine) __builtin_prefetch(static_cast<const char*>(at) + line, Write);
}

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
    std::vector<float> sh, extras;  // [N, K, 4], [N, E]
};

TracePass::TracePass(std::shared_ptr<const Bvh> bvh, const Gaussians& gaussians, const RayBatch& rays,
                     Vec3<float> background, float t_min, bool sh_along_ray, int threads)
    : bvh_(std::move(bvh)),
      g_(gaussians),
      rays_(rays),
      background_(background),
      t_min_(t_min),
      sh_along_ray_(sh_along_ray),
      threads_(threads) {}

int TracePass::chunks() const { return (rays_.count + kChunk - 1) / kChunk; }

void TracePass::forward(Planes<float> out, int* hits, float* weights, bool keep_hits) {
    chunk_hits_.assign(keep_hits ? chunks() : 0, {});
    hit_counts_.assign(keep_hits ? rays_.count : 0, 0);
    std::vector<std::vector<float>> partial(threads_);
    parallel(threads_, [&](int worker) {
        partial[worker].assign(g_.count, 0.0f);
        Traversal traversal(*bvh_);
        for (int chunk = worker; chunk < chunks(); chunk += threads_)
            for (int ray = chunk * kChunk; ray < std::min((chunk + 1) * kChunk, rays_.count); ++ray) {
                Vec3<float> origin = ray_at(rays_.origins, ray), direction = ray_at(rays_.directions, ray);
                const std::vector<Hit>& found = traversal.hits(origin, direction, t_min_, rays_.transmittance_min[ray]);
                BlendedSums<float> sums = {};
                float transmittance = 1.0f, extras[kMaxExtras] = {};
                for (size_t k = 0; k < found.size(); ++k) {
                    if (k + kAhead < found.size()) {
                        int ahead = found[k + kAhead].index();
                        prefetch<sizeof(TracedSurfel)>(&bvh_->surfels[ahead]);
                        prefetch<kColors>(g_.sh + 3l * g_.sh_coefficients * ahead);
                    }
                    const Hit& hit = found[k];
                    int i = hit.index();
                    const TracedSurfel& s = bvh_->surfels[i];
                    float weight = transmittance * hit.alpha;
                    transmittance *= 1.0f - hit.alpha;
                    Vec3<float> color = color_at(g_, i, sh_along_ray_ ? direction : s.mean - origin);
                    float side = dot(s.frame.n, direction) < 0.0f ? 1.0f : -1.0f;
                    blend(sums, weight, color, hit.t(), side, s.frame.n);
                    for (int e = 0; e < g_.extra_count; ++e) extras[e] += weight * g_.extras[g_.extra_count * i + e];
                    partial[worker][i] += weight;
                    if (keep_hits) chunk_hits_[chunk].push_back(i);
                }
                if (keep_hits) hit_counts_[ray] = int(found.size());
                write_blended(out, ray, sums, transmittance, background_);
                for (int e = 0; e < g_.extra_count; ++e) out.extras[e * out.pixels + ray] = extras[e];
                hits[ray] = int(found.size());
            }
    });
    std::fill(weights, weights + g_.count, 0.0f);
    for (const auto& part : partial)
        for (int i = 0; i < g_.count; ++i) weights[i] += part[i];
}

// Eight surfels, one a lane; lanes past the end repeat the last.
SurfelValues<Float8> TracePass::gather(const int* hits, int count) const {
    alignas(64) float gathered[kSurfelValues][kGroup];
    for (int lane = 0; lane < kGroup; ++lane) {
        const float* values = array_of<float>(bvh_->surfels[hits[std::min(lane, count - 1)]]);
        for (int k = 0; k < kSurfelValues; ++k) gathered[k][lane] = values[k];
    }
    SurfelValues<Float8> surfels;
    std::memcpy(&surfels, gathered, sizeof surfels);
    return surfels;
}

void TracePass::differentiate_ray(int ray, const int* hits, int count, Planes<const float> out,
                                  Planes<const float> gradient, TracedSurfelSums* sums, float* g_sh, float* g_extras,
                                  RayGradients rays, bool removals) const {
    Vec3<float> origin = ray_at(rays_.origins, ray), direction = ray_at(rays_.directions, ray);
    auto [g, remaining] = read_gradient(out, gradient, ray, background_);
    float g_extra[kMaxExtras], transmittance = 1.0f;
    for (int e = 0; e < g_.extra_count; ++e) {
        g_extra[e] = read(gradient.extras, e * out.pixels + ray);
        remaining += g_extra[e] * out.extras[e * out.pixels + ray];
    }
    Float4 g_blended = {g.color.x, g.color.y, g.color.z, 0.0f};
    Vec3<float> g_origin = {0, 0, 0}, g_direction = {0, 0, 0};
    Vec3<Float8> o = {Float8{} + origin.x, Float8{} + origin.y, Float8{} + origin.z};
    Vec3<Float8> d = {Float8{} + direction.x, Float8{} + direction.y, Float8{} + direction.z};

    for (int begin = 0; begin < count; begin += kGroup) {
        int group = std::min(kGroup, count - begin);
        const float* sh[kGroup];
        float* to_sh[kGroup];
        for (int lane = 0; lane < group; ++lane) {
            sh[lane] = g_.sh + 3l * g_.sh_coefficients * hits[begin + lane];
            to_sh[lane] = g_sh + 4l * g_.sh_coefficients * hits[begin + lane];
        }
        for (int next = begin + kGroup; next < std::min(begin + 2 * kGroup, count); ++next) {
            int i = hits[next];
            prefetch<sizeof(TracedSurfel)>(&bvh_->surfels[i]);
            prefetch<sizeof(TracedSurfelSums), 1>(&sums[i]);
            prefetch<kColors>(g_.sh + 3l * g_.sh_coefficients * i);
            prefetch<kColors, 1>(g_sh + 4l * g_.sh_coefficients * i);
        }
        SurfelValues<Float8> surfels = gather(hits + begin, group);
        const SurfelFrame<Float8>& frame = surfels.frame;
        PlaneHit<Float8> hit = intersect(frame, o - surfels.mean, d);
        Float8 alpha = response_alpha(surfels.opacity, hit.u * hit.u + hit.v * hit.v);
        Float8 side = select(hit.d_z < 0.0f, Float8{} + 1.0f, Float8{} - 1.0f);
        SeenColors seen;
        see_colors(g_, sh, group, sh_along_ray_ ? d : surfels.mean - o, seen);

        // Along the ray, hit after hit: transmittance, dL/dα.
        alignas(32) float weights[kGroup] = {}, g_alpha[kGroup] = {};
        Float4 g_color[kGroup];
        for (int lane = 0; lane < group; ++lane) {
            int i = hits[begin + lane];
            Vec3<float> color = {seen.color[lane][0], seen.color[lane][1], seen.color[lane][2]};
            float value = hit_value(g, color, float(hit.t[lane]), float(side[lane]), bvh_->surfels[i].frame.n);
            for (int e = 0; e < g_.extra_count; ++e) value += g_extra[e] * g_.extras[g_.extra_count * i + e];
            HitGradient<float> g_hit = blend_backward(float(alpha[lane]), value, transmittance, remaining);
            weights[lane] = g_hit.weight, g_alpha[lane] = g_hit.alpha;
            g_color[lane] = g_hit.weight * g_blended;
            sums[i].normal = sums[i].normal + (side[lane] * g_hit.weight) * g.normal;
        }

        Float8 weight = load_lanes<Float8>(weights);
        Vec3<Float8> g_v = see_colors_backward(g_, sh, group, seen, g_color, to_sh);
        AlphaGradient<Float8> ga = alpha_backward(surfels.opacity, alpha, load_lanes<Float8>(g_alpha));
        if (removals) ga.opacity = removal_square(alpha, load_lanes<Float8>(g_alpha));
        Vec3<Float8> local = intersect_backward(hit, dot(frame.u, d), dot(frame.v, d), weight * g.depth,
                                                2.0f * ga.rho * hit.u, 2.0f * ga.rho * hit.v);
        SurfelMoments<Float8> moments = {};
        add_hit(moments, hit, local);
        for (int lane = 0; lane < group; ++lane) {
            int i = hits[begin + lane];
            TracedSurfelSums& sum = sums[i];
            float* to = array_of<float>(sum.moments);
            for (int k = 0; k < kMoments; ++k) to[k] += array_of<Float8>(moments)[k][lane];
            sum.opacity += ga.opacity[lane];
            if (!sh_along_ray_)
                sum.color_direction = sum.color_direction + Vec3<float>{g_v.x[lane], g_v.y[lane], g_v.z[lane]};
            for (int e = 0; e < g_.extra_count; ++e) g_extras[g_.extra_count * i + e] += weights[lane] * g_extra[e];
        }

        typename LanesOf<Float8>::Int inside;
        for (int lane = 0; lane < kGroup; ++lane) inside[lane] = lane < group ? -1 : 0;
        auto total = [&](Vec3<Float8> v) -> Vec3<float> {
            auto sum = [&](Float8 x) { return sum_lanes(select(inside, x, Float8{})); };
            return {sum(v.x), sum(v.y), sum(v.z)};
        };
        Vec3<Float8> world = local.x * frame.u + local.y * frame.v + local.z * frame.n;
        g_origin = g_origin + total(sh_along_ray_ ? world : world - g_v);
        g_direction = g_direction + total(sh_along_ray_ ? hit.t * world + g_v : hit.t * world);
    }
    store3(rays.origins + 3l * ray, g_origin);
    store3(rays.directions + 3l * ray, g_direction);
}

void TracePass::backward(Planes<const float> out, Planes<const float> gradient, GaussianGradients result,
                         RayGradients rays, bool removals) {
    std::vector<Worker> workers(threads_);
    parallel(threads_, [&](int w) {
        Worker& worker = workers[w];
        worker.sums.assign(g_.count, TracedSurfelSums{});
        worker.sh.assign(4l * g_.sh_coefficients * g_.count, 0.0f);
        worker.extras.assign(long(g_.extra_count) * g_.count, 0.0f);
        for (int chunk = w; chunk < chunks(); chunk += threads_) {
            const int* hits = chunk_hits_[chunk].data();
            for (int ray = chunk * kChunk; ray < std::min((chunk + 1) * kChunk, rays_.count); ++ray) {
                differentiate_ray(ray, hits, hit_counts_[ray], out, gradient, worker.sums.data(), worker.sh.data(),
                                  worker.extras.data(), rays, removals);
                hits += hit_counts_[ray];
            }
        }
    });
    parallel_ranges(threads_, g_.count, [&](int begin, int end, int) { finish_surfels(begin, end, workers, result); });
}

void TracePass::finish_surfels(int begin, int end, const std::vector<Worker>& workers, GaussianGradients result) const {
    constexpr int kSums = count_of<TracedSurfelSums, float>;
    for (int i = begin; i < end; ++i) {
        TracedSurfelSums sum = workers[0].sums[i];
        for (size_t w = 1; w < workers.size(); ++w) {
            const float* other = array_of<float>(workers[w].sums[i]);
            for (int k = 0; k < kSums; ++k) array_of<float>(sum)[k] += other[k];
        }
        float inverse_norm;
        Quaternion<float> q = normalized(quaternion_at(g_, i), inverse_norm);
        SurfelGradient<float> g =
            surfel_backward(axes_of(q), g_.scales[2 * i], g_.scales[2 * i + 1], sum.moments, sum.normal);
        store3(result.means + 3l * i, g.mean + sum.color_direction);
        store3(result.position_gradients + 3l * i, g.position_statistic);
        Quaternion<float> gq = quaternion_gradient(q, inverse_norm, g.torque);
        float* to = result.quaternions + 4l * i;
        to[0] = gq.w, to[1] = gq.x, to[2] = gq.y, to[3] = gq.z;
        result.scales[2l * i] = g.scale_u;
        result.scales[2l * i + 1] = g.scale_v;
        result.opacities[i] = sum.opacity;
    }
    long rows = g_.sh_coefficients, extras = g_.extra_count;
    for (const Worker& worker : workers) {
        for (long k = rows * begin; k < rows * end; ++k)
            store3(result.sh + 3 * k, load3(result.sh + 3 * k) + load3(worker.sh.data() + 4 * k));
        for (long k = extras * begin; k < extras * end; ++k) result.extras[k] += worker.extras[k];
    }
}

}  // namespace envgs
