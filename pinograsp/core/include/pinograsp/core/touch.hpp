// Where a hand touches an object at many postures.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "approach.hpp"
#include "area.hpp"
#include "body.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// A part of a hand.
struct PartOfHand {
    int joint;  // -1: fixed in the world
    Frame frame;
    int link;
    Body hull, surface;  // without the second it is convex

    const Body& shape() const { return surface.empty() ? hull : surface; }
};

// What a joint carries: its mass [kg], and that times its centre in the joint's frame.
struct Load {
    double mass;
    Triple moment;
};

// A hand and an object.
struct TouchScene {
    int inputs = 0;
    std::vector<Joint> joints;  // parents first
    std::vector<Load> loads;    // of the joints
    std::vector<PartOfHand> parts;
    std::vector<std::array<int, 2>> pairs;  // of parts that may hit each other
    std::vector<Body> solids;               // convex each, together about the object; or its surface alone
    Body surface;                           // the object's own, where that is not the one solid
    Solid hull;                             // the object's convex hull, whose lowest points are on a table
    Frame root, object;                     // the hand as the first joints' frames have it; the object's shape
};

// Of `grasps` postures, and of the touches that are found, one after the other; as in pinograsp.contacts.bulk.
struct Touches {
    std::size_t grasps = 0;
    std::vector<std::int64_t> grasp, part, counts, collision, failed;
    std::vector<double> gap, points, normals, corners, leaning, jacobians, depth, gravity;

    void clear() {
        grasps = 0;
        for (auto* one : {&grasp, &part, &counts, &collision, &failed}) one->clear();
        for (auto* one : {&gap, &points, &normals, &corners, &leaning, &jacobians, &depth, &gravity}) one->clear();
    }
};

struct TouchOptions {
    double tolerance, lean;  // [m], [rad]
    Triple gravity;
    double deepest = tolerance;  // [m] what is farther inside is no touch
    bool collisions = true;      // of the hand with itself: whether they are looked for
    bool follows = false;        // what touched at the last call is pressed from the same side
    bool hulls = false;          // convex parts stand for the surfaces of hand and object
    double beside = std::numeric_limits<double>::infinity();  // [m] what is farther off touches at a point
};

// Finds touches, with memory of its own.
class Toucher {
public:
    explicit Toucher(const TouchScene& scene)
        : scene_(scene),
          joints_(scene.joints.size()),
          parts_(scene.parts.size()),
          best_(scene.parts.size()),
          last_(scene.parts.size()),
          now_(scene.parts.size()),
          ways_(scene.parts.size() * scene.solids.size()) {
        for (std::size_t i = 0; i < scene.solids.size(); ++i)
            if (i == 0)
                around_ = scene.solids[i].bounds();
            else
                around_.add(scene.solids[i].bounds());
    }

    // At the posture q, the hand's root at `root`.
    void touch(const double* q, const Frame& root, const TouchOptions& options, Touches& found) {
        put(q, root);
        const std::int64_t grasp = static_cast<std::int64_t>(found.grasps++);
        double depth = 0.0;
        bool failed = false;
        std::fill(last_.begin(), last_.end(), Held{});
        follows_ = options.follows;
        if (follows_) last_.swap(now_);
        find_near(options.tolerance, options.hulls);
        for (Candidate& best : best_) {
            if (best.part < 0) continue;
            const WayOut way = best.way.found ? best.way : measure_touch(best, options.hulls);
            failed = failed || !way.found;
            if (!way.found || !(way.gap <= options.tolerance)) continue;
            if (way.gap < -options.deepest) {
                depth = std::max(depth, -way.gap);
                continue;
            }
            note(grasp, best, way, options, found);
            now_[scene_.parts[best.part].link] = {best.part, best.solid, way.gap, back_.turn(way.normal)};
        }
        found.depth.push_back(depth);
        found.failed.push_back(failed);
        found.collision.push_back(options.collisions ? find_collision() : -1);
        bear(options.gravity, found.gravity);
    }

    // What touched at the last call, of each link: which part and solid, how far apart, and the normal, in the world.
    struct Held {
        int part = -1, solid = -1;
        double gap = 0.0;
        Triple normal{};
    };
    const std::vector<Held>& held() const { return now_; }
    void hold(const std::vector<Held>& held) { now_ = held; }

    void forget() {
        std::fill(now_.begin(), now_.end(), Held{});
        std::fill(ways_.begin(), ways_.end(), Memory{});
    }

    // Distance of some parts of the hand from the object, up to `reach`: of convex hulls, from below.
    double gap(const double* q, const Frame& root, const std::vector<int>& parts, double reach) {
        put(q, root);
        follows_ = false;
        near_.clear();
        for (int part : parts) list_near(part, reach);
        std::sort(near_.begin(), near_.end());
        for (const Near& near : near_) {
            if (near.room >= reach) break;
            reach = std::min(reach, look(near, reach).distance);
        }
        return reach;
    }

    // Where the parts are in the world at a posture (p), the hand's root at `root`.
    void place(const double* q, const Frame& root, std::vector<Frame>& placed) {
        put(q, root);
        for (const Frame& part : parts_) placed.push_back(back_ * part);
    }

private:
    static constexpr double off = 1e-3;            // [m] how far the object is moved off: directions keep their digits
    static constexpr double expected = 2.0 * off;  // [m] of the gap that is then left, as a rule
    static constexpr double flush = 1e-4;          // [m] behind the hull: on it
    static constexpr int rounds = 12;              // of finding the direction,
    static constexpr double alike = 1e-4;          // and where it has settled [rad]
    static constexpr double play = 1e-5;   // [m] by which convex parts may overlap: bars drawn side by side slide so
    static constexpr double rolled = 0.3;  // of what pressed before [rad]
    static constexpr double most = std::numeric_limits<double>::max();

    struct Near {
        double room;  // [m] they are at least so far apart
        int part, solid;
        bool operator<(const Near& other) const {
            return room != other.room   ? room < other.room
                   : part != other.part ? part < other.part
                                        : solid < other.solid;
        }
    };
    struct WayOut {
        bool found = false, settled = false;
        double gap = 0.0;
        Triple point{}, normal{};
    };
    struct Candidate {
        int part = -1, solid = -1;
        Separation gap{};  // in the part's frame
        WayOut way{};      // where it is known already
    };
    // Of a part and a solid, as the part sees it: where they were nearest, and likewise, for surfaces and for hulls,
    // the solid moved off.
    struct Memory {
        Triple way{};
        NearestPieces near, moved_off[2];
    };

    const Frame& joint_at(int joint) const { return joint < 0 ? still_ : joints_[joint]; }

    // The hand stays where it is, and the object is seen from there.
    void put(const double* q, const Frame& root) {
        back_ = root * scene_.root.inverse();
        object_ = back_.inverse() * scene_.object;
        place_joints(scene_.joints, q, joints_);
        for (std::size_t i = 0; i < parts_.size(); ++i)
            parts_[i] = joint_at(scene_.parts[i].joint) * scene_.parts[i].frame;
    }

    // Pairs of a part and the object's solids whose bounding volumes are nearer than that.
    void list_near(int part, double reach) {
        const Frame there = parts_[part].inverse() * object_;
        if (scene_.parts[part].hull.empty()) return;
        const Bounds& own = scene_.parts[part].hull.bounds();
        if (room_between(own, around_, there, reach) > reach) return;
        for (std::size_t s = 0; s < scene_.solids.size(); ++s)
            if (const double room = room_between(own, scene_.solids[s].bounds(), there, reach); room <= reach)
                near_.push_back({room, part, static_cast<int>(s)});
    }

    // The gap of a pair, as seen from the part; looked for first where it was before, if that is to be followed.
    Separation look(const Near& near, double beyond) {
        const Frame there = parts_[near.part].inverse() * object_;
        const Body &hull = scene_.parts[near.part].hull, &solid = scene_.solids[near.solid];
        Memory& before = memory_of(near.part, near.solid);
        Triple along = before.way;
        if (!follows_ || dot(along, along) == 0.0) along = towards(hull, solid, there);
        if (hull.whole() && !solid.whole() && !scene_.hull.empty()) {
            // Most are clear of the object's convex hull, which takes one look.
            const Parting plane = part({hull.piece(0), scene_.hull, there}, along, roughly, beyond);
            if (plane.distance > beyond) {
                if (follows_) before.way = plane.normal;
                return {plane.distance, plane.normal};
            }
        }
        const Separation gap = Nearest(hull, solid, there, along, beyond, true, follows_ ? &before.near : nullptr).gap;
        if (follows_) before.way = gap.normal;
        return gap;
    }

    Memory& memory_of(int part, int solid) { return ways_[part * scene_.solids.size() + solid]; }

    // The nearest part of each link, where it is within the tolerance: what presses first.
    void find_near(double tolerance, bool hulls) {
        near_.clear();
        for (std::size_t i = 0; i < parts_.size(); ++i) list_near(static_cast<int>(i), tolerance);
        std::sort(near_.begin(), near_.end());
        std::fill(best_.begin(), best_.end(), Candidate{});
        if (follows_ && (hulls || scene_.surface.empty()))
            for (const Held& held : last_)
                if (held.part >= 0 && held.gap < off / 10.0 && (hulls || scene_.parts[held.part].surface.empty()))
                    follow(held);
        for (const Near& near : near_) {
            Candidate& best = best_[scene_.parts[near.part].link];
            if (best.part == near.part && best.solid == near.solid) continue;
            // Of solids that share what is nearest, the first stays, whatever rounding does.
            const double beyond = best.part < 0 ? tolerance : best.gap.distance - 1e-12;
            if (near.room > beyond) continue;
            if (const Separation gap = look(near, beyond); gap.distance <= beyond)
                best = Candidate{near.part, near.solid, gap};
        }
    }

    // What pressed at the last call, where it still does so from that side.
    void follow(const Held& held) {
        const Triple last = back_.turn_back(held.normal);
        const WayOut way = leave(scene_.parts[held.part].hull, scene_.solids[held.solid], parts_[held.part], last,
                                 off - held.gap, most, &memory_of(held.part, held.solid).moved_off[true]);
        if (way.settled && is_from(way.normal, last))
            best_[scene_.parts[held.part].link] = {held.part, held.solid, {way.gap}, way};
    }

    static bool is_from(const Triple& normal, const Triple& last) {
        return dot(normal, last) > 1.0 - rolled * rolled / 2.0;
    }

    // Separation, the point on the object's surface, and the inward normal: its own, not its parts'.
    WayOut measure_touch(const Candidate& best, bool hulls) {
        const PartOfHand& part = scene_.parts[best.part];
        const bool solid = hulls || scene_.surface.empty(), convex = solid && (hulls || part.surface.empty());
        const Body& mine = hulls ? part.hull : part.shape();
        const Body& beneath = solid ? scene_.solids[best.solid] : scene_.surface;
        const Separation& gap = best.gap;
        const Frame& at = parts_[best.part];
        const Triple normal = at.turn(gap.normal);
        if (gap.apart > off / 10.0 && convex) return {true, true, gap.distance, at.act(gap.other), normal};
        // Inside, the object is moved off until it is clear, along the normal of its convex part, or, where that leads
        // along a wall, in the direction that is shortest.
        const double far = off - gap.distance;
        const Triple last = back_.turn_back(last_[part.link].normal);
        const bool follows = last_[part.link].part >= 0;
        NearestPieces afresh,
            &before = follows_ ? memory_of(best.part, solid ? best.solid : 0).moved_off[convex] : afresh;
        WayOut found = leave(mine, beneath, at, follows ? last : normal, far, most, &before);
        if (follows && found.settled && is_from(found.normal, last)) return found;
        if (found.found && found.gap > -2.0 * std::max(far, off / 2.0) &&
            (found.settled || found.gap < gap.distance + 3.0 * off))
            return found;
        for (int i = 0; i < 12; ++i) {  // to the corners of an icosahedron
            const double one = (i & 1 ? -1.0 : 1.0) / 1.902113, other = (i & 2 ? -1.618034 : 1.618034) / 1.902113;
            Triple start{};
            start[(i / 4 + 1) % 3] = one, start[(i / 4 + 2) % 3] = other;
            NearestPieces from;
            const WayOut way =
                leave(mine, beneath, at, start, far, found.settled ? 2.0 * off - found.gap : most, &from);
            if (way.found &&
                (way.settled > found.settled || !found.found || (way.settled == found.settled && way.gap > found.gap)))
                found = way;
        }
        return found;
    }

    // Along the common normal to which that one leads, the object moved `far` at first. Where it is clear of the part,
    // their nearest points tell the next normal. Not farther than that [m].
    WayOut leave(const Body& mine, const Body& other, const Frame& at, Triple normal, double far, double farthest,
                 NearestPieces* before) const {
        WayOut found;
        for (int i = 0; i < rounds && far <= farthest; ++i) {
            Frame moved = object_;
            moved.t = moved.t + far * normal;
            const Frame there = at.inverse() * moved;
            const Triple along = at.turn_back(normal);
            Separation gap = Nearest(mine, other, there, along, expected, true, before).gap;
            if (!(gap.distance <= expected)) gap = Nearest(mine, other, there, along, most, true, before).gap;
            if (!(std::fabs(gap.distance) < most)) return {};
            if (gap.distance < off / 10.0) {  // deeper than thought
                far += off + std::max(-gap.distance, 0.0);
                continue;
            }
            const Triple direction = at.turn(gap.normal), surface = at.act(gap.other) - far * normal;
            const bool settled = dot(direction, normal) > 1.0 - alike * alike / 2.0;
            found = {true, settled, dot(surface - at.act(gap.mine), direction), surface, direction};
            if (settled) break;
            far = std::max(far - gap.distance + off, off);
            normal = direction;
        }
        return found;
    }

    // What of the object is convex where it is touched: the part, or its hull where that is its surface.
    const Solid* solid_at(const Candidate& best, const WayOut& way) const {
        const Body& solid = scene_.solids[best.solid];
        if (solid.whole()) return &solid.piece(0);
        if (scene_.hull.empty()) return nullptr;
        const Triple outermost = object_.act(scene_.hull.farthest(object_.turn_back(-1.0 * way.normal)));
        return dot(way.point - outermost, way.normal) < flush ? &scene_.hull : nullptr;
    }

    void note(std::int64_t grasp, const Candidate& best, const WayOut& way, const TouchOptions& options,
              Touches& found) const {
        const auto write = [](std::vector<double>& to, const Triple& one) {
            to.insert(to.end(), one.begin(), one.end());
        };
        const PartOfHand& part = scene_.parts[best.part];
        found.grasp.push_back(grasp);
        found.part.push_back(best.part);
        found.gap.push_back(way.gap);
        write(found.points, back_.act(way.point));
        write(found.normals, back_.turn(way.normal));
        Area area{{way.point, way.point, way.point, way.point}, 1, {}};
        if (!(way.gap > options.beside))
            area = CommonArea(part.hull.whole() ? &part.hull.piece(0) : nullptr, parts_[best.part], solid_at(best, way),
                              object_, way.point, way.normal, options.lean)
                       .find();
        found.counts.push_back(area.count);
        for (const Triple& corner : area.corners) write(found.corners, back_.act(corner));
        found.leaning.insert(found.leaning.end(), area.leaning.begin(), area.leaning.end());
        // Of the touching point of the link, linear part first.
        const std::size_t n = scene_.inputs, start = found.jacobians.size();
        found.jacobians.resize(start + 6 * n, 0.0);
        double* rows = found.jacobians.data() + start;
        for (int j = part.joint; j >= 0; j = scene_.joints[j].parent) {
            const Joint& joint = scene_.joints[j];
            const Triple turning = joints_[j].turn(joint.angular);
            const Triple moving = back_.turn(joints_[j].turn(joint.linear) + cross(turning, way.point - joints_[j].t));
            const Triple turned = back_.turn(turning);
            for (int x = 0; x < 3; ++x) {
                rows[x * n + joint.input] += moving[x];
                rows[(3 + x) * n + joint.input] += turned[x];
            }
        }
    }

    // The first pair of the hand's own parts that overlap, -1: none.
    std::int64_t find_collision() const {
        for (std::size_t k = 0; k < scene_.pairs.size(); ++k) {
            const auto [i, j] = scene_.pairs[k];
            const Body &one = scene_.parts[i].shape(), &other = scene_.parts[j].shape();
            if (one.empty() || other.empty()) continue;
            const Triple apart = parts_[j].act(other.bounds().middle) - parts_[i].act(one.bounds().middle);
            const double most = one.bounds().radius + other.bounds().radius, size = length(apart);
            if (!(size <= most)) continue;
            const Frame there = parts_[i].inverse() * parts_[j];
            if (room_between(one.bounds(), other.bounds(), there, 0.0) > 0.0) continue;
            const Triple along = size > 0.0 ? parts_[i].turn_back((1.0 / size) * apart) : Triple{1.0, 0.0, 0.0};
            if (!(Nearest(one, other, there, along, 0.0, false).gap.distance <= 0.0)) continue;
            const bool solid = one.whole() && other.whole();
            if (!solid || Nearest(one, other, there, along, 0.0).gap.distance <= -play)
                return static_cast<std::int64_t>(k);
        }
        return -1;
    }

    // What holds the hand's own weight at the inputs.
    void bear(const Triple& gravity, std::vector<double>& torques) {
        const std::size_t start = torques.size();
        torques.resize(start + scene_.inputs, 0.0);
        const Triple down = back_.turn_back(gravity);
        carried_.assign(joints_.size(), {});
        for (std::size_t j = joints_.size(); j-- > 0;) {
            const Joint& joint = scene_.joints[j];
            Load& own = carried_[j];
            const Load& load = scene_.loads[j];
            own.mass += load.mass;
            own.moment = own.moment + load.mass * joints_[j].t + joints_[j].turn(load.moment);
            const Triple force = own.mass * down, torque = cross(own.moment - own.mass * joints_[j].t, down);
            torques[start + joint.input] -= dot(joints_[j].turn(joint.linear), force);
            torques[start + joint.input] -= dot(joints_[j].turn(joint.angular), torque);
            if (joint.parent < 0) continue;
            Load& parent = carried_[joint.parent];
            parent.mass += own.mass;
            parent.moment = parent.moment + own.moment;
        }
    }

    const TouchScene& scene_;
    Frame back_, object_, still_;  // from the hand as it stays to the world; the object there
    Bounds around_;
    std::vector<Frame> joints_, parts_;
    std::vector<Near> near_;
    std::vector<Candidate> best_;  // of each link
    std::vector<Held> last_, now_;
    std::vector<Memory> ways_;  // of each part and solid (p, s)
    bool follows_ = false;
    std::vector<Load> carried_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
