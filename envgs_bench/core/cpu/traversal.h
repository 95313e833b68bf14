// BVH traversal: finds a ray's hits, nearest first.
//
// The BVH is traversed depth first, nearer children first. No node still to be visited can hold a hit nearer than the
// nearest box on the stack, so all hits found up to there are final: they are accepted during the traversal, in the
// order of (t, index), and the traversal ends when the ray's transmittance does. One traversal a ray, however many hits
// it has; it is never restarted, so no hit can be lost or blended twice.
#pragma once
#include <bit>
#include <vector>

#include "bvh.h"

namespace envgs {

struct Hit {
    uint64_t key;  // t's bits above the primitive's index: sorts by t, then by index, since t >= 0
    float alpha;

    float t() const {
        uint32_t bits = uint32_t(key >> 32);
        float value;
        std::memcpy(&value, &bits, sizeof value);
        return value;
    }
    int index() const { return int(uint32_t(key)); }
};

class Traversal {
public:
    explicit Traversal(const Bvh& bvh) : bvh_(bvh), stack_children_(64), stack_nearest_(64) {}

    // The hits that a ray blends, in order. Valid until the next call.
    const std::vector<Hit>& hits(Vec3<float> origin,      // world units
                                 Vec3<float> direction,   // world frame, any length; zero hits nothing
                                 float t_min,             // hits at smaller t are skipped, units of |direction|
                                 float transmittance_min  // the ray ends with the hit that takes it below this
    );

private:
    void visit_node(const BvhNode& node);
    void visit_leaf(const BvhLeaf& leaf);
    bool finalize_hits(float t_end);

    const Bvh& bvh_;
    int stack_size_ = 0;
    std::vector<int> stack_children_;   // nodes and leaves to visit, with room for eight more
    std::vector<float> stack_nearest_;  // the smallest t at which this one or one below it is entered
    std::vector<Hit> found_;            // sorted; those before finalized_ are in blended_
    size_t finalized_ = 0;
    std::vector<Hit> blended_;
    Vec3<float> origin_, direction_, inverse_;
    float t_min_, transmittance_, transmittance_min_;
};

inline void Traversal::visit_node(const BvhNode& node) {
    auto slab = [&](int axis, float origin, float inverse, Float8& enter, Float8& leave) {
        Float8 a = (load_lanes<Float8>(node.low[axis]) - origin) * inverse;
        Float8 b = (load_lanes<Float8>(node.high[axis]) - origin) * inverse;
        enter = maximum(minimum(a, b), enter);  // in this order: −0 leaves 0, whose bits sort, as it is
        leave = minimum(leave, maximum(a, b));
    };
    Float8 enter = Float8{} + t_min_, leave = Float8{} + kInfinity;
    slab(0, origin_.x, inverse_.x, enter, leave);
    slab(1, origin_.y, inverse_.y, enter, leave);
    slab(2, origin_.z, inverse_.z, enter, leave);
    // Widened by the rounding of a few operations, so that no box is entered later than its content is hit.
    enter = enter * (1.0f - 1e-6f);
    leave = leave * (1.0f + 1e-6f);
    Int8 entered = (enter <= leave) & (load_lanes<Float8>(node.low[0]) <= load_lanes<Float8>(node.high[0]));
    unsigned bits = mask_bits(entered);
    if (!bits) return;
    // Sorted with the farthest first, so that the nearest ends on top of the stack, and without a branch, which would
    // be mispredicted: keys are t's bits, the last three of them replaced by the lane. That rounds t down.
    constexpr Int8 lanes = {0, 1, 2, 3, 4, 5, 6, 7};
    Int8 sorted = sorted_lanes(select(entered, ((Int8)enter & ~7) | lanes, Int8{} - 1));
    Int8 children;
    std::memcpy(&children, node.child, sizeof children);
    Float8 nearest = Float8{} + (stack_size_ ? stack_nearest_[stack_size_ - 1] : kInfinity);
    store_lanes(&stack_children_[stack_size_], permuted(children, sorted & 7));
    store_lanes(&stack_nearest_[stack_size_], minimum((Float8)(sorted & ~7), nearest));
    stack_size_ += std::popcount(bits);
    if (stack_size_ + 8 > int(stack_children_.size())) {
        stack_children_.resize(2 * stack_children_.size());
        stack_nearest_.resize(stack_children_.size());
    }
}

inline void Traversal::visit_leaf(const BvhLeaf& leaf) {
    auto rows = [](const float (&m)[3][8]) -> Vec3<Float8> {
        return {load_lanes<Float8>(m[0]), load_lanes<Float8>(m[1]), load_lanes<Float8>(m[2])};
    };
    Vec3<Float8> d = {Float8{} + direction_.x, Float8{} + direction_.y, Float8{} + direction_.z};
    Vec3<Float8> o = {Float8{} + origin_.x, Float8{} + origin_.y, Float8{} + origin_.z};
    PlaneHit<Float8> hit = intersect<Float8>({rows(leaf.u), rows(leaf.v), rows(leaf.n)}, o - rows(leaf.mean), d);
    Float8 rho = hit.u * hit.u + hit.v * hit.v;
    unsigned bits = mask_bits((rho <= load_lanes<Float8>(leaf.support)) & (hit.t >= t_min_) & (hit.t < kInfinity) &
                              (absolute(hit.d_z) > kDirectionEpsilon));
    if (!bits) return;
    float alpha[8];
    uint32_t t[8];
    store_lanes(alpha, response_alpha(load_lanes<Float8>(leaf.opacity), rho));
    std::memcpy(t, &hit.t, sizeof t);
    for (; bits; bits &= bits - 1) {
        int lane = __builtin_ctz(bits);
        Hit entry = {uint64_t(t[lane] & 0x7fffffffu) << 32 | uint32_t(leaf.index[lane]), alpha[lane]};
        found_.push_back(entry);
        size_t at = found_.size() - 1;
        for (; at > finalized_ && found_[at - 1].key > entry.key; --at) found_[at] = found_[at - 1];
        found_[at] = entry;
    }
}

// Accepts the hits before t_end, beyond which nearer ones may still be found; true when the ray has ended.
inline bool Traversal::finalize_hits(float t_end) {
    for (; transmittance_ >= transmittance_min_; ++finalized_) {  // never where the threshold is NaN
        if (finalized_ == found_.size() || !(found_[finalized_].t() < t_end)) return false;
        blended_.push_back(found_[finalized_]);
        transmittance_ *= 1.0f - found_[finalized_].alpha;
    }
    return true;
}

inline const std::vector<Hit>& Traversal::hits(Vec3<float> origin, Vec3<float> direction, float t_min,
                                               float transmittance_min) {
    // A component of 0 would make 0·∞ of a box that touches the ray; a tiny one only makes it very far away.
    auto inverse = [](float x) { return 1.0f / (std::fabs(x) > 1e-20f ? x : std::copysign(1e-20f, x)); };
    origin_ = origin;
    direction_ = direction;
    inverse_ = {inverse(direction.x), inverse(direction.y), inverse(direction.z)};
    t_min_ = t_min + 0.0f;  // −0 becomes 0, whose bits sort
    transmittance_ = 1.0f;
    transmittance_min_ = transmittance_min;
    stack_size_ = 0;
    found_.clear();
    blended_.clear();
    finalized_ = 0;
    bool has_direction = direction.x != 0.0f || direction.y != 0.0f || direction.z != 0.0f;
    if (bvh_.nodes.empty() || !has_direction) return blended_;
    visit_node(bvh_.nodes[0]);
    while (stack_size_) {
        int child = stack_children_[--stack_size_];
        if (finalize_hits(stack_nearest_[stack_size_])) return blended_;
        if (child >= 0)
            visit_node(bvh_.nodes[child]);
        else
            visit_leaf(bvh_.leaves[~child]);
    }
    finalize_hits(kInfinity);
    return blended_;
}

}  // namespace envgs
