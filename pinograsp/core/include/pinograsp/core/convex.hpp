// Convex solids, and the plane that parts two of them: Gilbert, Johnson and Keerthi's method (GJK), 1988.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "lanes.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

using Triple = std::array<double, 3>;

inline Triple operator+(const Triple& a, const Triple& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Triple operator-(const Triple& a, const Triple& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Triple operator*(double s, const Triple& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline double dot(const Triple& a, const Triple& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline double length(const Triple& a) { return std::sqrt(dot(a, a)); }
inline Triple cross(const Triple& a, const Triple& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// A placement: x in the frame is R x + t outside; R row by row.
struct Frame {
    std::array<double, 9> R{1, 0, 0, 0, 1, 0, 0, 0, 1};
    Triple t{};

    Triple turn(const Triple& a) const {
        return {R[0] * a[0] + R[1] * a[1] + R[2] * a[2], R[3] * a[0] + R[4] * a[1] + R[5] * a[2],
                R[6] * a[0] + R[7] * a[1] + R[8] * a[2]};
    }
    Triple turn_back(const Triple& a) const {
        return {R[0] * a[0] + R[3] * a[1] + R[6] * a[2], R[1] * a[0] + R[4] * a[1] + R[7] * a[2],
                R[2] * a[0] + R[5] * a[1] + R[8] * a[2]};
    }
    Triple act(const Triple& a) const { return turn(a) + t; }
    Frame operator*(const Frame& other) const {
        Frame found;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j)
                found.R[3 * i + j] =
                    R[3 * i] * other.R[j] + R[3 * i + 1] * other.R[3 + j] + R[3 * i + 2] * other.R[6 + j];
        found.t = act(other.t);
        return found;
    }
};

// The hull of points, and an ellipsoid about each of its points: balls make it round, flat ones cylinders.
struct Solid {
    std::vector<Triple> points;
    Triple radii{};

    // The point farthest along a direction, in its own frame.
    Triple farthest(const Triple& along) const {
        const Triple* best = points.data();
        double most = -std::numeric_limits<double>::infinity();
        for (const Triple& point : points)
            if (const double far = dot(point, along); far > most) most = far, best = &point;
        const Triple stretched{radii[0] * along[0], radii[1] * along[1], radii[2] * along[2]};
        const double size = length(stretched);
        if (size == 0.0) return *best;
        return *best + (1.0 / size) * Triple{radii[0] * stretched[0], radii[1] * stretched[1], radii[2] * stretched[2]};
    }
};

// Points of a difference of solids, at most four, of which the origin is nearest to a point of all of them.
class Simplex {
public:
    // Takes a point in, leaves those out that the nearest point does not need; the nearest point.
    Triple nearest_with(const Triple& point) {
        corners_[count_++] = point;
        const int all = count_;
        double least = std::numeric_limits<double>::infinity();
        Triple found{};
        int kept = 1;
        // Few enough to try every face, edge and corner that has the new point.
        for (int others = 0; others < 1 << (all - 1); ++others) {
            const int members = others | 1 << (all - 1);
            Triple near;
            if (!inside(members, near)) continue;
            if (const double size = dot(near, near); size < least) least = size, found = near, kept = members;
        }
        count_ = 0;
        for (int i = 0; i < all; ++i)
            if (kept >> i & 1) corners_[count_++] = corners_[i];
        return found;
    }

    bool full() const { return count_ == 4; }

private:
    // The point nearest to the origin in the plane of some corners, and whether it lies between them.
    bool inside(int members, Triple& near) const {
        const Triple* at[4];
        int n = 0;
        for (int i = 0; i < count_; ++i)
            if (members >> i & 1) at[n++] = &corners_[i];
        if (n == 4) {  // the origin is inside, if anywhere
            near = {};
            const Triple a = *at[1] - *at[0], b = *at[2] - *at[0], c = *at[3] - *at[0], o = -1.0 * *at[0];
            const double volume = dot(a, cross(b, c));
            if (volume == 0.0) return false;
            const double x = dot(o, cross(b, c)) / volume, y = dot(a, cross(o, c)) / volume,
                         z = dot(a, cross(b, o)) / volume;
            return x >= 0.0 && y >= 0.0 && z >= 0.0 && x + y + z <= 1.0;
        }
        near = *at[0];
        if (n == 1) return true;
        const Triple a = *at[1] - *at[0];
        const double aa = dot(a, a), ao = -dot(a, *at[0]);
        if (n == 2) {
            if (!(aa > 0.0)) return false;
            near = near + ao / aa * a;
            return ao >= 0.0 && ao <= aa;
        }
        const Triple b = *at[2] - *at[0];
        const double bb = dot(b, b), ab = dot(a, b), bo = -dot(b, *at[0]), det = aa * bb - ab * ab;
        if (!(det > 0.0)) return false;
        const double x = (bb * ao - ab * bo) / det, y = (aa * bo - ab * ao) / det;
        near = near + x * a + y * b;
        return x >= 0.0 && y >= 0.0 && x + y <= 1.0;
    }

    Triple corners_[4];
    int count_ = 0;
};

// A plane between two solids.
struct Parting {
    double distance;  // at least this far apart [m]; negative: no plane was found
    Triple normal;    // from the first to the second
};

// The widest gap between two solids, to a thousandth; whatever rounding does, there is that much.
inline Parting part(const Solid& one, const Frame& at, const Solid& other, const Frame& there) {
    constexpr int most = 40;
    constexpr double near = 1e-3, off = 1e-8;
    Parting best{-std::numeric_limits<double>::infinity(), {1.0, 0.0, 0.0}};
    Simplex simplex;
    Triple v = at.act(one.points[0]) - there.act(other.points[0]);
    for (int i = 0; i < most; ++i) {
        const double size = length(v);
        if (!(size > off)) break;
        const Triple along = (-1.0 / size) * v;
        const Triple w =
            at.act(one.farthest(at.turn_back(along))) - there.act(other.farthest(there.turn_back(-1.0 * along)));
        const double gap = -dot(w, along);
        if (gap > best.distance) best = {gap, along};
        if (size - best.distance <= near * size + off) break;
        const Triple next = simplex.nearest_with(w);
        if (simplex.full() || (i > 0 && !(dot(next, next) < size * size))) break;
        v = next;
    }
    return best;
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
