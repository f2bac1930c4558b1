// How deep a shape is in an object, along the common normal of their surfaces.
#pragma once

#include <cmath>

#include "body.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// How a depth is found, as in pinograsp.contacts.penetration.
struct DepthSearch {
    double clear, far, alike, roughly, deep;  // [m], [rad], [m]
    int rounds;
};

// A depth [m], negative where clear; the normal inwards, and the point on the object, in the world.
struct Depth {
    bool found = false;
    double depth = 0.0;
    Triple normal{}, point{};
};

// The object is moved off along the normal known so far, until it is clear; there the direction between the nearest
// points is the next one.
inline Depth find_depth(const Body& part, const Frame& at, const Body& object, const Frame& there, const Triple& start,
                        const DepthSearch& how) {
    Depth found;
    Triple normal = start;
    double off = how.clear + std::max(how.deep, 0.0), further = how.clear;
    double turned = std::numeric_limits<double>::infinity();
    NearestPieces pieces;
    for (int round = 0; round < how.rounds; ++round) {
        Frame moved = there;
        moved.t = there.t + off * normal;
        const Separation gap = Nearest(part, object, at.inverse() * moved, at.turn_back(normal),
                                       std::numeric_limits<double>::max(), true, &pieces)
                                   .gap;
        if (!(gap.distance >= 0.5 * how.clear) || !(gap.apart > 0.0)) {  // deeper than thought
            off += further + std::min(std::max(-gap.distance, 0.0), 10.0 * how.clear);
            further *= 2.0;
            continue;
        }
        further = how.clear;
        const Triple next = at.turn(gap.normal), other = at.act(gap.other);
        const double spare = gap.distance - how.clear, before = turned;
        turned = length(next - normal);
        const bool settled =
            turned < how.roughly && turned * turned < how.alike * before && std::isfinite(how.alike * before);
        const bool alike = turned < how.alike || settled || (0.5 * before < turned && turned < how.roughly);
        found = {true, off - gap.distance * dot(next, normal), normal, other - off * normal};
        // Far off, its place as it is tells: bringing the object closer may go round the part.
        if (alike && (std::fabs(spare) <= 0.5 * how.clear || (off == 0.0 && spare > 0.0))) return found;
        normal = next;
        off = off - spare > -how.far ? off - spare : 0.0;
    }
    found.normal = normal;
    return found;
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
