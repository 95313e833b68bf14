// Packet traversal: finds the hits of a few neighboring rays by one warp.
//
// The rays traverse the BVH together, inside a shaft: along the axis that they advance most on, their positions on the
// other two lie between straight lines. The warp tests a node's 32 boxes against the shaft at once, a thread each.
// Leaves that overlap the shaft are queued and tested against the rays, a thread a ray and leaf; pairs that intersect
// are queued in turn, and their surfels are intersected, a thread each. So every step is the same for all threads, a
// node is fetched once a packet, and no surfel is tested on a ray that misses its leaf.
//
// A ray lists its hits as they are found, unsorted. Once those listed would end it, nothing beyond the farthest can
// matter, and its far end shrinks to that; a full list is sorted and cut to what is blended. Where that cannot make
// room, the nearest are kept and another search starts strictly after the last pair (t, index) blended: no hit is lost
// or blended twice. Rays too unlike the packet's first form groups of their own.
#pragma once
#include "trace.cuh"

namespace envgs {

constexpr int kListCapacity = 56;               // hits a ray may list in a search; even, at most 64
constexpr int kListStride = kListCapacity + 4;  // rays' lists begin four banks apart in shared memory
constexpr int kListSlack = 8;                   // free places that cutting must leave
constexpr int kStackSize = 100;                 // 2²⁴ surfels leave 4 children at the top, then at most 31, 31 and 32
constexpr int kLeavesAtOnce = 32 / kRays, kPairsAtOnce = 32 / kLeaf;
constexpr int kLeafRing = 64, kPairRing = 64;
constexpr float kGroupSlope = 0.12f;               // rays of a group: how far their slopes may differ from the first's
constexpr float kGroupOriginDistance = 1.0f / 24;  // and their origins, as a share of the scene
constexpr float kDepthSteps = 4096.0f;  // a ray's optical depth, −log₂ of its transmittance, is summed in these
constexpr float kOriginSlack = 2e-6f, kDistanceSlack = 4e-6f;  // relative rounding of a ray-box test

struct alignas(16) RayState {
    Vec3<float> origin;
    float from_t;
    Vec3<float> direction;
    float far_t;
    u32 listed;               // how many hits are listed, and 256 times the optical depth with them, rounded down
    u32 initial_depth;        // optical depth before them
    int from_slot;            // −1: hits at from_t itself are taken
    int far_slot;             // −1: hits at far_t itself are taken
    int dropped;              // hits beyond far_t may have been left for another search
    float transmittance_min;  // the ray ends with the hit that takes its transmittance below this,
    u32 end_depth;            // and with the hit that takes its optical depth above this
    int unused[5];            // rays begin in different banks
};

struct alignas(16) PacketMemory {
    RayState rays[kRays];
    float t[kRays][kListStride];
    u32 tag[kRays][kListStride];  // slot << 8 | alpha in 8 bits, rounded down
    uint2 stack[kStackSize];      // where the shaft enters (float), and level << 27 | group
    u32 leaves[kLeafRing];        // ring buffer of leaves that overlap the shaft
    u32 pairs[kPairRing];         // ring buffer of leaf << 4 | ray that enters it
};

struct Shaft {
    int axis;
    float sign;             // sign of the rays' directions along the axis
    float start, end;       // along sign·axis
    float low[2], high[2];  // position at the start, on the two other axes
    float slope_low[2], slope_high[2];
    int along, across[2];  // planes of boxes: the axis, and the two others
    u32 rays;              // bit r: ray r is in the group
};

ENVGS_FN float component(Vec3<float> v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

ENVGS_FN u32 optical_depth(float transmittance) {
    return u32(minimum(maximum(-__log2f(transmittance), 0.0f), 1000.0f) * kDepthSteps);
}

// Thread l works for ray l % kRays wherever threads stand for rays.
class Packet {
public:
    __device__ Packet(PacketMemory& memory, const Levels& levels, const float2* boxes, PackedSurfels surfels,
                      const Ray& ray, float t_min, float transmittance_min, float max_origin_distance)
        : m_(memory),
          levels_(levels),
          boxes_(boxes),
          surfels_(surfels),
          own_(memory.rays[lane_id() % kRays]),
          max_origin_distance_(max_origin_distance),
          stride_(levels.total()) {
        Vec3<float> d = ray.direction;
        float least = 1e-12f * maximum(absolute(d.x), maximum(absolute(d.y), absolute(d.z)));
        prepare(ray.origin.x, d.x, least, inverse_.x, entry_.x, exit_.x);
        prepare(ray.origin.y, d.y, least, inverse_.y, entry_.y, exit_.y);
        prepare(ray.origin.z, d.z, least, inverse_.z, entry_.z, exit_.z);
        if (lane_id() < kRays) {
            own_.origin = ray.origin, own_.direction = ray.direction;
            own_.from_t = t_min, own_.from_slot = -1;
            own_.transmittance_min = transmittance_min;
            own_.end_depth = optical_depth(0.999f * transmittance_min) + 1;
        }
        __syncwarp();
    }

    // Lists the nearest hits not yet blended, sorted, of the rays that want it.
    __device__ __forceinline__ void search(bool wanted, float transmittance) {
        __syncwarp();
        if (lane_id() < kRays) {
            own_.far_t = kInfinity, own_.far_slot = -1;
            own_.dropped = 0;
            own_.initial_depth = optical_depth(transmittance), own_.listed = own_.initial_depth << 8;
        }
        __syncwarp();
        ties_matter_ = __any_sync(kFullWarp, own_.from_slot >= 0);
        Vec3<float> d = own_.direction;
        float size = maximum(absolute(d.x), maximum(absolute(d.y), absolute(d.z)));
        wanted = wanted && size > 0.0f && size < kInfinity;
        for (u32 pending; (pending = __ballot_sync(kFullWarp, wanted) & ((1u << kRays) - 1)) != 0;) {
            Shaft shaft;
            form_group(pending, size, shaft);
            traverse(shaft);
            wanted = wanted && !(shaft.rays >> lane_id() % kRays & 1);
        }
        for (int r = 0; r < kRays; ++r) sort(r);
    }
    __device__ int count() const { return own_.listed & 255; }
    __device__ bool dropped() const { return own_.dropped; }
    __device__ float t(int k) const { return m_.t[lane_id() % kRays][k]; }
    __device__ u32 slot(int k) const { return m_.tag[lane_id() % kRays][k] >> 8; }
    // The ray's next search starts strictly after hit k of its list; k < 0 changes nothing.
    __device__ void resume_after(int k) {
        if (lane_id() < kRays && k >= 0) own_.from_t = t(k), own_.from_slot = slot(k);
        __syncwarp();
    }

private:
    __device__ static __forceinline__ void prepare(float origin, float direction, float least, float& inverse,
                                                   float& entry, float& exit) {
        inverse = 1.0f / (absolute(direction) > least ? direction : least);
        float slack = kOriginSlack * absolute(origin * inverse);
        entry = -origin * inverse - slack, exit = -origin * inverse + slack;
    }

    // The group of the first pending ray, and the shaft around it.
    __device__ __forceinline__ void form_group(u32 pending, float size, Shaft& s) const {
        const RayState& leader = m_.rays[__ffs(pending) - 1];
        Vec3<float> o = own_.origin, d = own_.direction, lo = leader.origin, ld = leader.direction;
        float ax = absolute(ld.x), ay = absolute(ld.y), az = absolute(ld.z);
        s.axis = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
        s.sign = component(ld, s.axis) < 0.0f ? -1.0f : 1.0f;
        int b = s.axis == 0 ? 1 : 0, c = s.axis == 2 ? 1 : 2;
        float along = s.sign * component(d, s.axis), origin_along = s.sign * component(o, s.axis);
        float inverse = 1.0f / along, leader_inverse = s.sign / component(ld, s.axis);
        float slope[2] = {component(d, b) * inverse, component(d, c) * inverse};
        bool similar = along > 0.3f * size && absolute(slope[0] - component(ld, b) * leader_inverse) < kGroupSlope &&
                       absolute(slope[1] - component(ld, c) * leader_inverse) < kGroupSlope &&
                       absolute(o.x - lo.x) < max_origin_distance_ && absolute(o.y - lo.y) < max_origin_distance_ &&
                       absolute(o.z - lo.z) < max_origin_distance_;
        int ray = lane_id() % kRays;
        bool member = (pending >> ray & 1) && (similar || ray == __ffs(pending) - 1);
        s.rays = __ballot_sync(kFullWarp, member) & ((1u << kRays) - 1);
        float start = origin_along + own_.from_t * along;
        s.start = warp_min(member ? start : kInfinity);
        s.start -= 1e-5f * absolute(s.start);
        float origin[2] = {component(o, b), component(o, c)};
#pragma unroll
        for (int k = 0; k < 2; ++k) {
            float moved = slope[k] * (s.start - origin_along), at_start = origin[k] + moved;
            float slack = 2e-6f * (absolute(origin[k]) + absolute(moved));
            s.low[k] = warp_min(member ? at_start - slack : kInfinity);
            s.high[k] = warp_max(member ? at_start + slack : -kInfinity);
            s.slope_low[k] = warp_min(member ? slope[k] : kInfinity);
            s.slope_high[k] = warp_max(member ? slope[k] : -kInfinity);
        }
        s.along = s.axis * stride_, s.across[0] = b * stride_, s.across[1] = c * stride_;
        shrink(s);
    }

    __device__ void shrink(Shaft& s) const {
        float along = s.sign * component(own_.direction, s.axis), origin = s.sign * component(own_.origin, s.axis);
        float end = own_.far_t < kInfinity ? origin + own_.far_t * along : kInfinity;
        s.end = warp_max(s.rays >> lane_id() % kRays & 1 ? end : -kInfinity);
        s.end += 1e-5f * absolute(s.end);
    }

    // A box as the shaft sees it: (low, high) along its axis, and on the two others.
    struct SeenBox {
        float2 along, across[2];
    };

    // This thread's box of a group. A __syncwarp() must follow: over it the compiler cannot move a load to its first
    // use, so all loads are on their way before anything waits for one.
    __device__ SeenBox fetch(const Shaft& s, int group_at) const {
        const float2* boxes = boxes_ + group_at + lane_id();
        return {boxes[s.along], {boxes[s.across[0]], boxes[s.across[1]]}};
    }

    // Whether the box overlaps the shaft, and where along it.
    __device__ bool overlaps(const Shaft& s, const SeenBox& box, float& near) const {
        near = fmaxf(s.sign < 0.0f ? -box.along.y : box.along.x, s.start);
        float far = fminf(s.sign < 0.0f ? -box.along.x : box.along.y, s.end);
        bool intersected = near <= far;
        float advance_near = near - s.start, advance_far = far - s.start;
#pragma unroll
        for (int k = 0; k < 2; ++k) {
            float low = s.low[k] + fminf(s.slope_low[k] * advance_near, s.slope_low[k] * advance_far);
            float high = s.high[k] + fmaxf(s.slope_high[k] * advance_near, s.slope_high[k] * advance_far);
            intersected = intersected & (box.across[k].x <= high) & (box.across[k].y >= low);
        }
        return intersected;
    }

    struct Ring {
        u32 head = 0;
        int count = 0;
    };

    __device__ __forceinline__ void traverse(Shaft& s) {
        int depth = 0;
        Ring leaves, pairs;
        uint2 node = make_uint2(__float_as_uint(s.start), u32(levels_.count - 1) << 27);
        for (;;) {
            int level = node.y >> 27, group = node.y & ((1u << 27) - 1);
            if (__uint_as_float(node.x) > s.end) {
                // every ray of the group has ended before it
            } else if (level > 0) {
                depth = push_children(s, level, group, depth);
            } else {
                SeenBox box = fetch(s, 32 * group);
                __syncwarp();
                float near;
                bool intersected = overlaps(s, box, near);
                enqueue<kLeafRing>(m_.leaves, leaves, intersected, 32 * group + lane_id());
                __syncwarp();
                while (leaves.count >= kLeavesAtOnce) test_leaves(s, leaves, pairs);
            }
            if (depth == 0) break;
            node = m_.stack[--depth];
        }
        if (leaves.count) test_leaves(s, leaves, pairs);
        if (pairs.count) test_pairs(s, pairs);
    }

    template <int Size>
    __device__ static __forceinline__ void enqueue(u32* ring, Ring& at, bool wanted, u32 value) {
        u32 threads = __ballot_sync(kFullWarp, wanted);
        if (wanted) ring[(at.head + at.count + __popc(threads & ((1u << lane_id()) - 1))) % Size] = value;
        at.count += __popc(threads);
    }

    // Tests the next leaves against the rays: thread l tests leaf l / kRays on its own ray.
    __device__ __forceinline__ void test_leaves(Shaft& s, Ring& leaves, Ring& pairs) {
        u32 which = lane_id() / kRays, ray = lane_id() % kRays;
        bool valid = int(which) < leaves.count && (s.rays >> ray & 1);
        u32 leaf = m_.leaves[(leaves.head + which) % kLeafRing];
        const float2* box = boxes_ + (valid ? leaf : 0);
        float2 x = box[0], y = box[stride_], z = box[2 * stride_];
        leaves.head += kLeavesAtOnce, leaves.count = max(leaves.count - kLeavesAtOnce, 0);
        __syncwarp();
        float t_enter = fmaxf(fmaxf(entry(x, inverse_.x, entry_.x), entry(y, inverse_.y, entry_.y)),
                              fmaxf(entry(z, inverse_.z, entry_.z), own_.from_t));
        float t_exit = fminf(fminf(exit(x, inverse_.x, exit_.x), exit(y, inverse_.y, exit_.y)),
                             fminf(exit(z, inverse_.z, exit_.z), own_.far_t));
        bool intersected = t_enter - kDistanceSlack * absolute(t_enter) <= t_exit + kDistanceSlack * absolute(t_exit);
        enqueue<kPairRing>(m_.pairs, pairs, valid && intersected, leaf << 4 | ray);
        __syncwarp();
        while (pairs.count >= kPairsAtOnce) test_pairs(s, pairs);
    }

    __device__ static __forceinline__ float entry(float2 box, float inverse, float offset) {
        return (inverse < 0.0f ? box.y : box.x) * inverse + offset;
    }
    __device__ static __forceinline__ float exit(float2 box, float inverse, float offset) {
        return (inverse < 0.0f ? box.x : box.y) * inverse + offset;
    }

    // Intersects the surfels of the next pairs' leaves with the pairs' rays, a thread a surfel, and lists the hits.
    __device__ __forceinline__ void test_pairs(Shaft& s, Ring& pairs) {
        u32 which = lane_id() / kLeaf;
        bool intersected = int(which) < pairs.count;
        u32 pair = intersected ? m_.pairs[(pairs.head + which) % kPairRing] : 0;
        pairs.head += kPairsAtOnce, pairs.count = max(pairs.count - kPairsAtOnce, 0);
        u32 slot = (pair >> 4) * kLeaf + lane_id() % kLeaf;
        int r = pair & 15;
        TracedSurfel surfel = surfels_.load(slot);
        RayState& ray = m_.rays[r];
        Vec3<float> origin = ray.origin, direction = ray.direction;
        float from_t = ray.from_t, far_t = ray.far_t;
        __syncwarp();
        PlaneHit<float> hit = intersect(surfel.frame, origin - surfel.mean, direction);
        float rho = hit.u * hit.u + hit.v * hit.v, t = hit.t;
        float alpha = response_alpha(surfel.opacity, rho);
        intersected = intersected & within_support(rho, alpha) & (t >= from_t) & (t <= far_t) &
                      (absolute(hit.d_z) > kDirectionEpsilon);
        if (ties_matter_) intersected = intersected && within_interval(ray, t, slot);
        if (!__any_sync(kFullWarp, intersected)) return;
        u32 tag = slot << 8 | u32(alpha * 256.0f);
        bool overflowed = false;
        if (intersected) {
            u32 place = atomicAdd(&ray.listed, (optical_depth(1.0f - alpha) << 8) + 1) & 255;
            overflowed = place >= kListCapacity;
            if (!overflowed) m_.t[r][place] = t, m_.tag[r][place] = tag;
        }
        __syncwarp();
        u32 left = __ballot_sync(kFullWarp, overflowed), moved = left;
        while (left) left = insert_overflowed(left, r, t, tag);
        u32 ended = __ballot_sync(kFullWarp, own_.listed >> 8 > own_.end_depth && !(own_.far_t < kInfinity));
        moved |= ended;
        for (ended &= (1u << kRays) - 1; ended; ended &= ended - 1) limit_to_farthest(__ffs(ended) - 1);
        if (moved) shrink(s);
    }

    // The hits that ray r lists end it: nothing beyond them matters.
    __device__ __forceinline__ void limit_to_farthest(int r) {
        int n = m_.rays[r].listed & 255, k0 = lane_id(), k1 = lane_id() + 32;
        float farthest = warp_max(fmaxf(k0 < n ? m_.t[r][k0] : -kInfinity, k1 < n ? m_.t[r][k1] : -kInfinity));
        __syncwarp();
        if (lane_id() == 0) m_.rays[r].far_t = farthest;
        __syncwarp();
    }

    // Nearest on top of the stack: a child's place is how many of the others lie nearer.
    __device__ __forceinline__ int push_children(const Shaft& s, int level, int group, int depth) {
        SeenBox box = fetch(s, levels_.offset[level] + 32 * group);
        __syncwarp();
        float near;
        u32 intersected = __ballot_sync(kFullWarp, overlaps(s, box, near));
        int nearer = 0;
        for (u32 rest = intersected; rest; rest &= rest - 1) {
            int other = __ffs(rest) - 1;
            float other_near = __shfl_sync(kFullWarp, near, other);
            nearer += other_near < near || (other_near == near && other < lane_id());
        }
        int above = depth + __popc(intersected);
        __syncwarp();
        if (intersected >> lane_id() & 1)
            m_.stack[above - 1 - nearer] =
                make_uint2(__float_as_uint(near), u32(level - 1) << 27 | u32(32 * group + lane_id()));
        __syncwarp();
        return above;
    }

    // At the ends of a ray's interval, the index decides.
    __device__ __forceinline__ bool within_interval(const RayState& ray, float t, u32 slot) const {
        if (t > ray.from_t && t < ray.far_t) return true;
        int index = surfels_.index(slot);
        if (t == ray.from_t && ray.from_slot >= 0 && surfels_.index(ray.from_slot) >= index) return false;
        return t < ray.far_t || ray.far_slot < 0 || index < surfels_.index(ray.far_slot);
    }

    __device__ static u32 optical_depth_of_tag(u32 tag) { return optical_depth(1.0f - (tag & 255) * (1.0f / 256.0f)); }

    // Lists hits of threads in `left` whose ray's list is full, those of one ray; returns the threads of other rays.
    __device__ __forceinline__ u32 insert_overflowed(u32 left, int ray_of_hit, float t, u32 tag) {
        int r = __shfl_sync(kFullWarp, ray_of_hit, __ffs(left) - 1);
        RayState& ray = m_.rays[r];
        u32 found = __ballot_sync(kFullWarp, (left >> lane_id() & 1) && ray_of_hit == r);
        left &= ~found;
        if (lane_id() == 0) ray.listed = kListCapacity;
        __syncwarp();
        for (;;) {
            truncate(r);
            bool remains = (found >> lane_id() & 1) && t <= ray.far_t;
            found = __ballot_sync(kFullWarp, remains && within_interval(ray, t, tag >> 8));
            if (!found) break;
            int count = ray.listed, place = count + __popc(found & ((1u << lane_id()) - 1));
            bool taken = (found >> lane_id() & 1) && place < kListCapacity;
            if (taken) m_.t[r][place] = t, m_.tag[r][place] = tag;
            u32 threads = __ballot_sync(kFullWarp, taken);
            found &= ~threads;
            __syncwarp();
            if (lane_id() == 0) ray.listed = count + __popc(threads);
            __syncwarp();
            if (!found) break;
        }
        return left;
    }

    // Sorts ray r's list, two hits a thread: a hit's place is how many others lie nearer.
    __device__ __forceinline__ void sort(int r) {
        int n = m_.rays[r].listed & 255, k0 = lane_id(), k1 = lane_id() + 32;
        if (n < 2) return;
        float* ts = m_.t[r];
        u32* tags = m_.tag[r];
        if (lane_id() < 3) ts[n + lane_id()] = kInfinity;  // pads the last float4
        __syncwarp();
        float t0 = k0 < n ? ts[k0] : kInfinity, t1 = k1 < n ? ts[k1] : kInfinity;
        u32 tag0 = k0 < n ? tags[k0] : 0, tag1 = k1 < n ? tags[k1] : 0;
        int place0 = 0, place1 = 0;
        const float4* values4 = reinterpret_cast<const float4*>(ts);
        if (n <= 32) {
            for (int k = 0; 4 * k < n; ++k) place0 += count_nearer(values4[k], t0);
        } else {
            for (int k = 0; 4 * k < n; ++k) {
                float4 value4 = values4[k];
                place0 += count_nearer(value4, t0), place1 += count_nearer(value4, t1);
            }
        }
        u32 places = __reduce_add_sync(kFullWarp, u32((k0 < n ? place0 : 0) + (k1 < n ? place1 : 0)));
        __syncwarp();
        if (places == n * (n - 1) / 2) {  // all distinct
            if (k0 < n) ts[place0] = t0, tags[place0] = tag0;
            if (k1 < n) ts[place1] = t1, tags[place1] = tag1;
        } else if (lane_id() == 0) {
            sort_with_ties(ts, tags, n);
        }
        __syncwarp();
    }

    __device__ static __forceinline__ int count_nearer(float4 value4, float t) {
        return (value4.x < t) + (value4.y < t) + (value4.z < t) + (value4.w < t);
    }

    // One thread, by (t, index).
    __device__ __forceinline__ void sort_with_ties(float* ts, u32* tags, int n) {
        for (int k = 1; k < n; ++k) {
            float t = ts[k];
            u32 tag = tags[k];
            int index = surfels_.index(tag >> 8), at = k;
            for (; at > 0; --at) {
                float before = ts[at - 1];
                u32 before_tag = tags[at - 1];
                if (before < t || (before == t && surfels_.index(before_tag >> 8) < index)) break;
                ts[at] = before, tags[at] = before_tag;
            }
            ts[at] = t, tags[at] = tag;
        }
    }

    // Cuts ray r's full list to what is certainly blended, or else to the nearest that leave room.
    __device__ __forceinline__ void truncate(int r) {
        sort(r);
        RayState& ray = m_.rays[r];
        int k = 2 * lane_id();
        u32 first = 0, second = 0;
        if (k < kListCapacity)
            first = optical_depth_of_tag(m_.tag[r][k]), second = optical_depth_of_tag(m_.tag[r][k + 1]);
        u32 through = warp_inclusive_sum(first + second);
        u32 before = ray.initial_depth, end_depth = ray.end_depth;
        u32 ended = __ballot_sync(kFullWarp, before + through > end_depth);
        int kept = kListCapacity;
        if (ended) {
            int thread = __ffs(ended) - 1;
            u32 through_first = __shfl_sync(kFullWarp, through - second, thread);
            kept = 2 * thread + (before + through_first > end_depth ? 1 : 2);
        }
        bool drops = kept > kListCapacity - kListSlack;
        if (drops) kept = kListCapacity - kListSlack;
        __syncwarp();
        if (lane_id() == 0) {
            ray.listed = kept;
            ray.far_t = m_.t[r][kept - 1], ray.far_slot = m_.tag[r][kept - 1] >> 8;
            ray.dropped |= drops;
        }
        ties_matter_ = true;
        __syncwarp();
    }

    PacketMemory& m_;
    const Levels& levels_;
    const float2* boxes_;
    PackedSurfels surfels_;
    RayState& own_;
    float max_origin_distance_;
    bool ties_matter_;     // some ray's interval ends at a surfel: see within_interval()
    int stride_;           // boxes in a plane
    Vec3<float> inverse_;  // 1 / the ray's direction
    // A ray reaches coordinate p of an axis at t = p·inverse_ + entry_ at the earliest, + exit_ at the latest.
    Vec3<float> entry_, exit_;
};

}  // namespace envgs
