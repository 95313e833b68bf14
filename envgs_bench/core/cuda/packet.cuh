// Finding the hits of a packet: a few neighbouring rays, one warp.
//
// The rays walk the tree together, inside a shaft: along the axis that they advance most on, their positions on the
// other two lie between straight lines. The warp holds a node's 32 boxes against the shaft at once, a thread each.
// Surfels whose boxes meet it queue up, and are put before each ray 32 at a time, a thread each. So every step is the
// same for all threads, and a node or a surfel is fetched once a packet.
//
// A ray lists the hits that it meets, unsorted. Once those listed would end it, nothing beyond the farthest can matter,
// and its far end shrinks to that; a full list is sorted and cut to what is blended. Where that cannot make room, the
// nearest are kept and another search starts strictly after the last pair (t, index) blended: no hit is lost or met
// twice. Rays too unlike the packet's first form groups of their own.
#pragma once
#include "trace.cuh"

namespace envgs {

constexpr int kListed = 64;               // hits a ray may list in a search
constexpr int kSpare = 8;                 // free places that cutting must leave
constexpr int kStack = 32 * (kMaxLevels - 1);
constexpr int kQueue = 128;
constexpr float kGroupSlope = 0.12f;      // rays of a group: how far their slopes may differ from the first's
constexpr float kGroupReach = 1.0f / 24;  // and their origins, as a share of the scene
constexpr float kDepthSteps = 1048576.0f; // a ray's optical depth, −log₂ of its transmittance, is summed in these

struct alignas(16) RayState {
    Vec3<float> origin;
    float from_t;
    Vec3<float> direction;
    float far_t;
    int from_slot;   // −1: hits at from_t itself are taken
    int far_slot;    // −1: hits at far_t itself are taken
    int count;       // of the listed hits
    int seen;        // how many of them `depth` and `farthest` know
    u32 first_depth; // optical depth before the listed hits, and with them; both rounded down
    u32 depth;
    float farthest;
    int dropped;     // hits beyond far_t may have been left for another search
};

struct alignas(16) PacketMemory {
    RayState rays[kRays];
    float t[kListed][kRays];
    u32 tag[kListed][kRays];  // slot << 8 | alpha in 8 bits, rounded down
    uint2 stack[kStack];      // where the shaft enters (float), and level << 27 | group
    u32 queue[kQueue];        // slots of surfels to be tested, a ring
};

struct Shaft {
    int axis;
    float sign;            // of the rays' direction along the axis
    float start, end;      // along sign·axis
    float low[2], high[2]; // position at the start, on the two other axes
    float slope_low[2], slope_high[2];
    int along, across[2];  // planes of boxes: the axis, and the two others
    u32 rays;              // bit r: ray r is in the group
};

ENVGS_FN float component(Vec3<float> v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

ENVGS_FN u32 depth_of(float transmittance) {
    return u32(minimum(maximum(-__log2f(transmittance), 0.0f), 1000.0f) * kDepthSteps);
}

// Thread l works for ray l % kRays wherever threads stand for rays.
class Packet {
public:
    __device__ Packet(PacketMemory& memory, const Levels& levels, const float2* boxes, const TracedSurfel* surfels,
                      const Ray& ray, float t_min, float transmittance_min, float reach)
        : m_(memory), levels_(levels), boxes_(boxes), surfels_(surfels), own_(memory.rays[lane_id() % kRays]),
          reach_(reach), end_depth_(depth_of(0.999f * transmittance_min) + 64) {
        if (lane_id() < kRays) {
            own_.origin = ray.origin, own_.direction = ray.direction;
            own_.from_t = t_min, own_.from_slot = -1;
        }
        __syncwarp();
    }

    // Lists the nearest hits not yet blended, sorted, of the rays that want it.
    __device__ void search(bool wanted, float transmittance) {
        __syncwarp();
        if (lane_id() < kRays) {
            own_.far_t = kInfinity, own_.far_slot = -1;
            own_.count = own_.seen = 0, own_.dropped = 0;
            own_.first_depth = own_.depth = depth_of(transmittance), own_.farthest = -kInfinity;
        }
        __syncwarp();
        Vec3<float> d = own_.direction;
        float size = maximum(absolute(d.x), maximum(absolute(d.y), absolute(d.z)));
        wanted = wanted && size > 0.0f && size < kInfinity;
        for (u32 pending; (pending = __ballot_sync(kFullWarp, wanted) & ((1u << kRays) - 1)) != 0;) {
            Shaft shaft;
            gather(pending, size, shaft);
            walk(shaft);
            wanted = wanted && !(shaft.rays >> lane_id() % kRays & 1);
        }
        for (int r = 0; r < kRays; ++r) sort(r);
    }
    __device__ int count() const { return own_.count; }
    __device__ bool dropped() const { return own_.dropped; }
    __device__ float t(int k) const { return m_.t[k][lane_id() % kRays]; }
    __device__ u32 slot(int k) const { return m_.tag[k][lane_id() % kRays] >> 8; }
    // The ray's next search starts strictly after hit k of its list; k < 0 changes nothing.
    __device__ void resume_after(int k) {
        if (lane_id() < kRays && k >= 0) own_.from_t = t(k), own_.from_slot = slot(k);
        __syncwarp();
    }

private:
    // The group of the first pending ray, and the shaft around it.
    __device__ void gather(u32 pending, float size, Shaft& s) const {
        const RayState& leader = m_.rays[__ffs(pending) - 1];
        Vec3<float> o = own_.origin, d = own_.direction, lo = leader.origin, ld = leader.direction;
        float ax = absolute(ld.x), ay = absolute(ld.y), az = absolute(ld.z);
        s.axis = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
        s.sign = component(ld, s.axis) < 0.0f ? -1.0f : 1.0f;
        int b = s.axis == 0 ? 1 : 0, c = s.axis == 2 ? 1 : 2;
        float along = s.sign * component(d, s.axis), origin_along = s.sign * component(o, s.axis);
        float inverse = 1.0f / along, leader_inverse = s.sign / component(ld, s.axis);
        float slope[2] = {component(d, b) * inverse, component(d, c) * inverse};
        bool alike = along > 0.3f * size && absolute(slope[0] - component(ld, b) * leader_inverse) < kGroupSlope &&
                     absolute(slope[1] - component(ld, c) * leader_inverse) < kGroupSlope &&
                     absolute(o.x - lo.x) < reach_ && absolute(o.y - lo.y) < reach_ && absolute(o.z - lo.z) < reach_;
        int ray = lane_id() % kRays;
        bool member = (pending >> ray & 1) && (alike || ray == __ffs(pending) - 1);
        s.rays = __ballot_sync(kFullWarp, member) & ((1u << kRays) - 1);
        float start = origin_along + maximum(own_.from_t, 0.0f) * along;
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
        int stride = levels_.total();
        s.along = s.axis * stride, s.across[0] = b * stride, s.across[1] = c * stride;
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

    // This thread's box of a group. A __syncwarp() must follow: over it the compiler cannot move a load to its first use,
    // so all loads are on their way before anything waits for one.
    __device__ SeenBox fetch(const Shaft& s, int group_at) const {
        const float2* boxes = boxes_ + group_at + lane_id();
        return {boxes[s.along], {boxes[s.across[0]], boxes[s.across[1]]}};
    }

    // Whether the shaft meets the box, and where along it.
    __device__ bool meets(const Shaft& s, const SeenBox& box, float& near) const {
        near = maximum(s.sign < 0.0f ? -box.along.y : box.along.x, s.start);
        float far = minimum(s.sign < 0.0f ? -box.along.x : box.along.y, s.end);
        bool met = near <= far;
        float advance_near = near - s.start, advance_far = far - s.start;
#pragma unroll
        for (int k = 0; k < 2; ++k) {
            float low = s.low[k] + minimum(s.slope_low[k] * advance_near, s.slope_low[k] * advance_far);
            float high = s.high[k] + maximum(s.slope_high[k] * advance_near, s.slope_high[k] * advance_far);
            met = met & (box.across[k].x <= high) & (box.across[k].y >= low);
        }
        return met;
    }

    __device__ void walk(Shaft& s) {
        int depth = 0, head = 0, queued = 0;
        uint2 node = make_uint2(__float_as_uint(s.start), u32(levels_.count - 1) << 27);
        for (;;) {
            int level = node.y >> 27, group = node.y & ((1u << 27) - 1);
            if (__uint_as_float(node.x) > s.end) {
                // passed by
            } else if (level > 0) {
                depth = push_children(s, level, group, depth);
            } else {
                // Two leaves at a time, where there are two: their loads wait for memory together.
                int other = -1;
                if (depth > 0) {
                    uint2 next = m_.stack[depth - 1];
                    if (next.y >> 27 == 0) {
                        --depth;
                        if (__uint_as_float(next.x) <= s.end) other = next.y;
                    }
                }
                SeenBox first_box = fetch(s, 32 * group), other_box = fetch(s, 32 * max(other, 0));
                __syncwarp();
                float near;
                bool met_first = meets(s, first_box, near), met_other = meets(s, other_box, near);
                u32 first = __ballot_sync(kFullWarp, met_first), second = __ballot_sync(kFullWarp, met_other);
                if (other < 0) second = 0;
                queued = enqueue(first, group, head, queued);
                queued = enqueue(second, other, head, queued);
                __syncwarp();
                for (; queued >= 32; head += 32, queued -= 32)
                    if (test(s.rays, m_.queue[(head + lane_id()) % kQueue], true)) shrink(s);
            }
            if (depth == 0) break;
            node = m_.stack[--depth];
        }
        if (queued) test(s.rays, m_.queue[(head + lane_id()) % kQueue], lane_id() < queued);
    }

    __device__ int enqueue(u32 met, int group, int head, int queued) {
        if (met >> lane_id() & 1)
            m_.queue[(head + queued + __popc(met & ((1u << lane_id()) - 1))) % kQueue] = 32 * group + lane_id();
        return queued + __popc(met);
    }

    // Nearest on top of the stack: a child's place is how many of the others lie nearer.
    __device__ int push_children(const Shaft& s, int level, int group, int depth) {
        SeenBox box = fetch(s, levels_.offset[level] + 32 * group);
        __syncwarp();
        float near;
        u32 met = __ballot_sync(kFullWarp, meets(s, box, near));
        int nearer = 0;
        for (u32 rest = met; rest; rest &= rest - 1) {
            int other = __ffs(rest) - 1;
            float other_near = __shfl_sync(kFullWarp, near, other);
            nearer += other_near < near || (other_near == near && other < lane_id());
        }
        int above = depth + __popc(met);
        __syncwarp();
        if (met >> lane_id() & 1)
            m_.stack[above - 1 - nearer] =
                make_uint2(__float_as_uint(near), u32(level - 1) << 27 | u32(32 * group + lane_id()));
        __syncwarp();
        return above;
    }

    // Puts a surfel a thread before the rays of a group; true where some ray's far end has moved.
    __device__ bool test(u32 rays, u32 slot, bool valid) {
        TracedSurfel s;
        if (valid) s = surfels_[slot];
        bool moved = false;
        u32 below = (1u << lane_id()) - 1;
#pragma unroll 1
        for (; rays; rays &= rays - 1) {
            int r = __ffs(rays) - 1;
            RayState& ray = m_.rays[r];
            PlaneHit<float> hit = intersect(s.frame, ray.origin - s.mean, ray.direction);
            float rho = hit.u * hit.u + hit.v * hit.v, t = hit.t;
            bool met = valid & (rho <= s.support) & (t >= ray.from_t) & (t <= ray.far_t) &
                       (absolute(hit.d_z) > kDirectionEpsilon);
            u32 found = __ballot_sync(kFullWarp, met);
            if (!found) continue;
            if (__any_sync(kFullWarp, met && (t == ray.from_t || t == ray.far_t)))
                found = __ballot_sync(kFullWarp, met && in_order(ray, t, slot));
            u32 tag = slot << 8 | u32(response_alpha(s.opacity, rho) * 256.0f);
            int count = ray.count, after = count + __popc(found);
            if (after < kListed) {
                int place = count + __popc(found & below);
                if (found >> lane_id() & 1) m_.t[place][r] = t, m_.tag[place][r] = tag;
                __syncwarp();
                if (lane_id() == 0) ray.count = after;
            } else {
                list_crowded(r, found, t, tag);
                moved = true;
            }
        }
        __syncwarp();
        bool ended = lane_id() < kRays && take_in();
        __syncwarp();
        return __any_sync(kFullWarp, ended) || moved;
    }

    // At the ends of a ray's interval, the index decides.
    __device__ bool in_order(const RayState& ray, float t, u32 slot) const {
        if (t > ray.from_t && t < ray.far_t) return true;
        int index = surfels_[slot].index;
        if (t == ray.from_t && ray.from_slot >= 0 && surfels_[ray.from_slot].index >= index) return false;
        return t < ray.far_t || ray.far_slot < 0 || index < surfels_[ray.far_slot].index;
    }

    // Thread r: what the newly listed hits mean for ray r; true where its far end has moved.
    __device__ bool take_in() {
        u32 depth = own_.depth;
        float farthest = own_.farthest;
        for (int k = own_.seen; k < own_.count; ++k) {
            depth += depth_of_tag(m_.tag[k][lane_id()]);
            farthest = maximum(farthest, m_.t[k][lane_id()]);
        }
        own_.seen = own_.count, own_.depth = depth, own_.farthest = farthest;
        bool ends = depth > end_depth_ && !(own_.far_t < kInfinity);
        if (ends) own_.far_t = farthest;
        return ends;
    }

    __device__ static u32 depth_of_tag(u32 tag) { return depth_of(1.0f - (tag & 255) * (1.0f / 256.0f)); }

    // Lists the hits of the threads in `found` with ray r where that fills the list: cut as often as need be.
    __device__ void list_crowded(int r, u32 found, float t, u32 tag) {
        RayState& ray = m_.rays[r];
        while (found) {
            int count = ray.count, place = count + __popc(found & ((1u << lane_id()) - 1));
            bool taken = (found >> lane_id() & 1) && place < kListed;
            if (taken) m_.t[place][r] = t, m_.tag[place][r] = tag;
            u32 threads = __ballot_sync(kFullWarp, taken);
            found &= ~threads;
            __syncwarp();
            if (lane_id() == 0) ray.count = count + __popc(threads);
            __syncwarp();
            if (ray.count < kListed) continue;
            cut(r);
            bool remains = (found >> lane_id() & 1) && t <= ray.far_t;
            found = __ballot_sync(kFullWarp, remains && in_order(ray, t, tag >> 8));
        }
    }

    // Sorts ray r's list, two hits a thread: a hit's place is how many others lie nearer.
    __device__ void sort(int r) {
        int n = m_.rays[r].count, k0 = lane_id(), k1 = lane_id() + 32;
        if (n < 2) return;
        float t0 = k0 < n ? m_.t[k0][r] : kInfinity, t1 = k1 < n ? m_.t[k1][r] : kInfinity;
        u32 tag0 = k0 < n ? m_.tag[k0][r] : 0, tag1 = k1 < n ? m_.tag[k1][r] : 0;
        u32 place0 = 0, place1 = 0;
#pragma unroll 4
        for (int k = 0; k < n; ++k) {
            float t = m_.t[k][r];
            place0 += t < t0;
            place1 += t < t1;
        }
        bool distinct = __reduce_add_sync(kFullWarp, (k0 < n ? place0 : 0) + (k1 < n ? place1 : 0)) == n * (n - 1) / 2;
        __syncwarp();
        if (distinct) {
            if (k0 < n) m_.t[place0][r] = t0, m_.tag[place0][r] = tag0;
            if (k1 < n) m_.t[place1][r] = t1, m_.tag[place1][r] = tag1;
        } else if (lane_id() == 0) {
            sort_with_ties(r, n);
        }
        __syncwarp();
    }

    // One thread, by (t, index).
    __device__ void sort_with_ties(int r, int n) {
        for (int k = 1; k < n; ++k) {
            float t = m_.t[k][r];
            u32 tag = m_.tag[k][r];
            int index = surfels_[tag >> 8].index, at = k;
            for (; at > 0; --at) {
                float before = m_.t[at - 1][r];
                u32 before_tag = m_.tag[at - 1][r];
                if (before < t || (before == t && surfels_[before_tag >> 8].index < index)) break;
                m_.t[at][r] = before, m_.tag[at][r] = before_tag;
            }
            m_.t[at][r] = t, m_.tag[at][r] = tag;
        }
    }

    // Cuts ray r's full list to what is certainly blended, or else to the nearest that leave room.
    __device__ void cut(int r) {
        sort(r);
        RayState& ray = m_.rays[r];
        int k = 2 * lane_id();
        u32 first = depth_of_tag(m_.tag[k][r]), second = depth_of_tag(m_.tag[k + 1][r]);
        u32 through = warp_inclusive_sum(first + second);
        u32 before = ray.first_depth;
        u32 ended = __ballot_sync(kFullWarp, before + through > end_depth_);
        int kept = kListed;
        if (ended) {
            int thread = __ffs(ended) - 1;
            u32 through_first = __shfl_sync(kFullWarp, through - second, thread);
            kept = 2 * thread + (before + through_first > end_depth_ ? 1 : 2);
        }
        bool drops = kept > kListed - kSpare;
        if (drops) kept = kListed - kSpare;
        __syncwarp();
        if (lane_id() == 0) {
            ray.count = ray.seen = kept;
            ray.far_t = m_.t[kept - 1][r], ray.far_slot = m_.tag[kept - 1][r] >> 8;
            ray.dropped |= drops;
        }
        __syncwarp();
    }

    PacketMemory& m_;
    const Levels& levels_;
    const float2* boxes_;
    const TracedSurfel* surfels_;
    RayState& own_;
    float reach_;
    u32 end_depth_;
};

}  // namespace envgs
