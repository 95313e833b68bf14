// The ray tracer.
#pragma once
#include <memory>
#include <vector>

#include "bvh.h"

namespace envgs {

struct RayBatch {
    const float *origins, *directions;  // [R, 3]
    int count;
};

struct RayGradients {
    float *origins, *directions;  // [R, 3]
};

// One bundle of rays. The forward pass keeps each ray's hits, so that the backward pass need not search again. The
// arrays of `gaussians` and `rays` must outlive it.
class TracePass {
public:
    TracePass(std::shared_ptr<const Bvh> bvh, const Gaussians& gaussians, const RayBatch& rays, Vec3<float> background,
              float t_min, float transmittance_min, int threads);

    // Fills the planes [R], hits [R] and the blending weights [N]. Hits are remembered only if `keep_hits`.
    void forward(Planes<float> out, int* hits, float* weights, bool keep_hits);
    void backward(Planes<const float> out, Planes<const float> gradient, GaussianGradients result, RayGradients rays);

private:
    struct Worker;
    struct TracedSurfelSums;

    int chunks() const;
    void differentiate_ray(int ray, const int* hits, int count, Planes<const float> out, Planes<const float> gradient,
                           TracedSurfelSums* sums, float* g_sh, float* g_extras, RayGradients rays) const;
    void finish_surfels(int begin, int end, const std::vector<Worker>& workers, GaussianGradients result) const;

    std::shared_ptr<const Bvh> bvh_;
    Gaussians g_;
    RayBatch rays_;
    Vec3<float> background_;
    float t_min_, transmittance_min_;
    int threads_;
    std::vector<std::vector<int>> chunk_hits_;  // primitive indices, ray after ray
    std::vector<int> hit_counts_;               // [R]
};

}  // namespace envgs
