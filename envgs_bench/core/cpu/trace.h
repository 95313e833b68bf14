// The ray tracer.
#pragma once
#include <memory>
#include <vector>

#include "bvh.h"

namespace envgs {

struct RayBatch {
    const float *origins, *directions;  // [R, 3] world units; world frame, any length
    const float* transmittance_min;     // [R] a ray ends with the hit that takes it below this
    int count;                          // R
};

struct RayGradients {
    float *origins, *directions;  // [R, 3] dL/dorigins, dL/ddirections
};

// One batch of rays. The forward pass keeps each ray's hits, so that the backward pass need not traverse the BVH again.
// The arrays of `gaussians` and `rays` must outlive it.
class TracePass {
public:
    TracePass(std::shared_ptr<const Bvh> bvh,  // over `gaussians`
              const Gaussians& gaussians,      // surfels
              const RayBatch& rays,
              Vec3<float> background,  // in [0, 1]
              float t_min,             // hits at smaller t are not drawn, units of |direction|
              bool sh_along_ray,       // SH at the ray's direction; else from its origin toward each surfel's center
              int threads              // workers; sums over rays depend on their number
    );

    void forward(Planes<float> out,  // filled, P = R
                 int* hits,          // [R] filled: surfels blended along each ray
                 float* weights,     // [N] filled: sums of the blending weights
                 bool keep_hits      // remember hits for backward()
    );
    void backward(Planes<const float> out,       // as forward() filled them
                  Planes<const float> gradient,  // dL/d(out)
                  GaussianGradients result,      // filled
                  RayGradients rays,             // filled
                  bool removals                  // Σ removal_square of each surfel, for dL/dopacity
    );

private:
    struct Worker;
    struct TracedSurfelSums;

    int chunks() const;
    SurfelValues<Float8> gather(const int* hits, int count) const;
    void differentiate_ray(int ray, const int* hits, int count, Planes<const float> out, Planes<const float> gradient,
                           TracedSurfelSums* sums, float* g_sh, float* g_extras, RayGradients rays,
                           bool removals) const;
    void finish_surfels(int begin, int end, const std::vector<Worker>& workers, GaussianGradients result) const;

    std::shared_ptr<const Bvh> bvh_;
    Gaussians g_;
    RayBatch rays_;
    Vec3<float> background_;
    float t_min_;
    bool sh_along_ray_;
    int threads_;
    std::vector<std::vector<int>> chunk_hits_;  // primitive indices, ray after ray
    std::vector<int> hit_counts_;               // [R]
};

}  // namespace envgs
