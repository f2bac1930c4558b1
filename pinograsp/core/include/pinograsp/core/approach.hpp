// How far a hand can go on its way before a part of it may touch an object: conservative advancement.
#pragma once

#include <cmath>
#include <vector>

#include "convex.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// A joint: its frame in its parent's at 0, and what a unit of its input adds to its velocity, in its own frame.
struct Joint {
    int parent, input;  // -1: the world; whose rate moves it
    Frame frame;
    Triple linear, angular;  // one of them zero

    // In its parent's frame, its input at a value.
    Frame at(double value) const {
        Frame found = frame;
        found.t = frame.act(value * linear);
        found.R = (Frame{frame.R, {}} * rotate_by(value * angular)).R;
        return found;
    }
};

// Where the joints are with their inputs at q; `frames`: as many.
inline void place_joints(const std::vector<Joint>& joints, const double* q, std::vector<Frame>& frames) {
    for (std::size_t j = 0; j < joints.size(); ++j) {
        const Frame own = joints[j].at(q[joints[j].input]);
        frames[j] = joints[j].parent < 0 ? own : frames[joints[j].parent] * own;
    }
}

// A convex part of a hand; without points: any shape, which is never told clear.
struct Part {
    int joint;  // -1: fixed in the world
    Frame frame;
    Solid solid;
    std::array<Triple, 8> corners;  // of a box around it, in the joint's frame
};

// What is known of the parts (p) on a way, as in pinograsp.contacts.advance.
struct Known {
    double *gaps, *since, *rates, *times, *stops;
    const double *speeds, *bends;
};

struct Margins {
    double touch, creep, near;  // [m]
};

class Way {
public:
    std::vector<Joint> joints;  // parents first
    std::vector<Part> parts;
    Solid object;

    // Goes on from `at` on the way q + (s - at) rate to where the next part may be nearer than `near`, at most to
    // `end`, as long as there are `steps`, which are used up.
    double pursue(double at, double end, const double* q, const double* rate, const Frame& there, const Known& known,
                  const Margins& margins, int& steps) {
        const double start = at;
        for (; at < end && steps > 0; --steps) {
            double next = end;
            for (std::size_t i = 0; i < parts.size(); ++i) next = std::min(next, known.stops[i]);
            next = std::max(next, at);
            put(q, rate, next - start);
            for (std::size_t i = 0; i < parts.size(); ++i)
                if (known.times[i] <= next + 1e-6 / std::max(known.speeds[i], 1e-9) &&
                    !look(i, next, there, known, margins))
                    return at;
            at = next;
        }
        return at;
    }

private:
    // Where the joints are at a length of the way, and how fast, in the world.
    void put(const double* q, const double* rate, double length) {
        moved_.resize(joints.size());
        for (std::size_t j = 0; j < joints.size(); ++j) {
            const Joint& joint = joints[j];
            Moved& own = moved_[j];
            const Moved* parent = joint.parent < 0 ? nullptr : &moved_[joint.parent];
            const Frame frame = joint.at(q[joint.input] + length * rate[joint.input]);
            own.frame = parent ? parent->frame * frame : frame;
            own.linear = own.angular = {};
            if (parent) {
                own.angular = parent->angular;
                own.linear = parent->linear + cross(parent->angular, own.frame.t - parent->frame.t);
            }
            own.linear = own.linear + own.frame.turn(rate[joint.input] * joint.linear);
            own.angular = own.angular + own.frame.turn(rate[joint.input] * joint.angular);
        }
    }

    // Whether part i is clear of the object; when it can touch first is noted.
    bool look(std::size_t i, double at, const Frame& there, const Known& known, const Margins& margins) const {
        const Part& part = parts[i];
        if (part.solid.empty() || object.empty()) return false;
        const Moved& moved = part.joint < 0 ? still_ : moved_[part.joint];
        const Frame placed = moved.frame * part.frame;
        const Couple couple{part.solid, object, placed.inverse() * there};
        Parting plane = core::part(couple, towards(couple), roughly);
        plane.normal = placed.turn(plane.normal);
        if (!(plane.distance >= margins.near)) return false;
        known.gaps[i] = plane.distance;
        known.since[i] = at;
        const double room = plane.distance - margins.touch, speed = known.speeds[i], bend = known.bends[i];
        if (!(speed > 0.0)) {
            known.times[i] = known.stops[i] = std::numeric_limits<double>::infinity();
            return true;
        }
        // What the plane's distance loses at first, at a corner of the box, and can lose at most.
        const Triple around = moved.frame.turn_back(cross(plane.normal, moved.angular));
        double across = -std::numeric_limits<double>::infinity();
        for (const Triple& corner : part.corners) across = std::max(across, dot(around, corner));
        const double rate = known.rates[i] = dot(plane.normal, moved.linear) + across;
        const double root = std::sqrt(rate * rate + 2.0 * bend * room);
        double wait = room / speed;
        if (rate > 0.0)
            wait = std::max(wait, 2.0 * room / (rate + root));
        else if (bend > 0.0)
            wait = std::max(wait, (root - rate) / bend);
        else
            wait = std::numeric_limits<double>::infinity();
        known.times[i] = at + wait;
        known.stops[i] = at + std::max(wait, margins.creep / speed);
        return true;
    }

    struct Moved {
        Frame frame;
        Triple linear{}, angular{};
    };
    std::vector<Moved> moved_;
    Moved still_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
