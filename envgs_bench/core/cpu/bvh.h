// A bounding volume hierarchy of surfels: eight children a node and eight surfels a leaf, one SIMD lane each.
#pragma once
#include <vector>

#include "gaussians.h"

namespace envgs {

// What a ray needs of a surfel; see array_of.
template <class R>
struct SurfelValues {
    SurfelFrame<R> frame;  // world to plane, in standard deviations
    Vec3<R> mean;          // world units
    R support, opacity;    // ρ at the edge of the support; in [0, 1]
};

struct alignas(64) TracedSurfel : SurfelValues<float> {};

struct alignas(64) BvhNode {
    float low[3][8], high[3][8];  // unused children: low > high, which no ray enters
    int child[8];                 // a node, or ~leaf
};

struct alignas(64) BvhLeaf {
    float u[3][8], v[3][8], n[3][8], mean[3][8];  // see SurfelFrame
    float support[8], opacity[8];                 // unused lanes: support < 0, which no ray hits
    int index[8];
};

class Bvh {
public:
    // Boxes are exact around each surfel's supporting disc. The hierarchy depends on the set alone, not on `threads`.
    Bvh(const Gaussians& gaussians,  // surfels
        int threads                  // workers that build it
    );

    std::vector<TracedSurfel> surfels;  // by primitive index; support < 0 where never visible
    std::vector<BvhNode> nodes;         // the root first; empty where no surfel is visible
    std::vector<BvhLeaf> leaves;
};

}  // namespace envgs
