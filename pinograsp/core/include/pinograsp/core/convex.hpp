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
    Triple act_back(const Triple& a) const { return turn_back(a - t); }
    Frame inverse() const {
        const Triple back = turn_back(t);
        return {{R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]}, {-back[0], -back[1], -back[2]}};
    }
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

// A homogeneous placement (4, 4).
inline Frame frame_at(const double* own) {
    Frame found;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) found.R[3 * i + j] = own[4 * i + j];
        found.t[i] = own[4 * i + 3];
    }
    return found;
}

// The rotation by a vector [rad] (Rodrigues).
inline Frame rotate_by(const Triple& by) {
    const double angle = length(by);
    Frame found;
    if (angle == 0.0) return found;
    const Triple u = (1.0 / angle) * by;
    const double s = std::sin(angle), c = std::cos(angle), t = 1.0 - c;
    found.R = {c + t * u[0] * u[0],        t * u[0] * u[1] - s * u[2], t * u[0] * u[2] + s * u[1],
               t * u[0] * u[1] + s * u[2], c + t * u[1] * u[1],        t * u[1] * u[2] - s * u[0],
               t * u[0] * u[2] - s * u[1], t * u[1] * u[2] + s * u[0], c + t * u[2] * u[2]};
    return found;
}

// A unit vector across another one.
inline Triple across(const Triple& normal) {
    int least = 0;
    for (int i = 1; i < 3; ++i)
        if (std::fabs(normal[i]) < std::fabs(normal[least])) least = i;
    Triple axis{};
    axis[least] = 1.0;
    const Triple found = cross(normal, axis);
    return (1.0 / length(found)) * found;
}

// The hull of points, and an ellipsoid about each of its points: balls make it round, flat ones cylinders.
class Solid {
public:
    Solid() = default;
    Solid(std::vector<Triple> points, const Triple& radii)
        : radii_(radii), ball_(radii[0] == radii[1] && radii[1] == radii[2]), count_(points.size()) {
        if (count_ > many) {
            gather(points, 0, count_);
            enclose(points);
        }
        blocks_.assign((count_ + width - 1) / width * 3 * width, 0.0);
        for (std::size_t i = 0; i < blocks_.size() / 3; ++i)
            for (std::size_t x = 0; x < 3; ++x)
                blocks_[i / width * 3 * width + x * width + i % width] = points[i < count_ ? i : 0][x];
    }

    bool empty() const { return count_ == 0; }
    Triple point(std::size_t i) const {
        const double* own = blocks_.data() + i / width * 3 * width + i % width;
        return {own[0], own[width], own[2 * width]};
    }

    // A radius of what is about each point of the core, which is the solid less that.
    double round() const { return ball_ ? radii_[0] : 0.0; }
    // The point of the core farthest along a direction.
    Triple farthest_of_core(const Triple& along) const {
        const Triple found = corner(along);
        return ball_ ? found : found + stretch(along);
    }
    // The point farthest along a direction.
    Triple farthest(const Triple& along) const { return corner(along) + stretch(along); }

private:
    // Neighbours in a box, and from how many points on there are boxes.
    static constexpr std::size_t neighbours = 32, many = 128;

    // The farthest so far: how far, and the first lane's number, for each lane.
    struct Farthest {
        Vector far = -std::numeric_limits<double>::infinity(), which = 0.0;

        void add(Vector other, std::size_t first) {
            const Mask better = other > far;
            far = select(better, other, far);
            which = select(better, Vector(static_cast<double>(first)), which);
        }
        // The first one of all lanes.
        std::size_t first() const {
            Vector lanes;
            for (int l = 0; l < width; ++l) in_lane(lanes, l) = static_cast<double>(l);
            const Mask farthest = far == Vector(most_of(far));
            return static_cast<std::size_t>(-most_of(select(farthest, -which - lanes, -1e300)));
        }
    };

    Triple corner(const Triple& along) const {
        if (count_ <= width) return few_corner(along);
        Farthest best;
        if (boxes_.empty()) {
            scan(along, 0, count_, best);
            return point(best.first());
        }
        // The most promising box, and then those that can have a point farther along than all of that one.
        const Triple size{std::fabs(along[0]), std::fabs(along[1]), std::fabs(along[2])};
        Farthest bound;
        for (std::size_t i = 0; i < boxes_.size() / 6; i += width) bound.add(bound_of(i, along, size), i);
        const std::size_t promising = bound.first();
        scan_box(along, promising, best);
        const double known = most_of(best.far);
        for (std::size_t i = 0; i < boxes_.size() / 6; i += width) {
            const Vector far = bound_of(i, along, size);
            if (!any(far > Vector(known))) continue;
            for (int l = 0; l < width; ++l)
                if (in_lane(far, l) > known && i + static_cast<std::size_t>(l) != promising)
                    scan_box(along, i + static_cast<std::size_t>(l), best);
        }
        return point(best.first());
    }

    void scan_box(const Triple& along, std::size_t box, Farthest& best) const {
        scan(along, box * neighbours, std::min(count_, (box + 1) * neighbours), best);
    }

    void scan(const Triple& along, std::size_t begin, std::size_t end, Farthest& best) const {
        const double* at = blocks_.data() + 3 * begin;
        for (std::size_t i = begin; i < end; i += width, at += 3 * width)
            best.add(lanes_at(at) * Vector(along[0]) + lanes_at(at + width) * Vector(along[1]) +
                         lanes_at(at + 2 * width) * Vector(along[2]),
                     i);
    }

    // No point in a box is farther along; of `width` boxes.
    Vector bound_of(std::size_t box, const Triple& along, const Triple& size) const {
        const double* at = boxes_.data() + 6 * box;
        Vector found = 0.0;
        for (int x = 0; x < 3; ++x, at += width) found = found + lanes_at(at) * Vector(along[x]);
        for (int x = 0; x < 3; ++x, at += width) found = found + lanes_at(at) * Vector(size[x]);
        return found;
    }

    // Puts neighbours next to each other: halves along the longest side, as long as there are more than one box takes.
    static void gather(std::vector<Triple>& points, std::size_t begin, std::size_t end) {
        if (end - begin <= neighbours) return;
        Triple least = points[begin], most = least;
        for (std::size_t i = begin; i < end; ++i)
            for (int x = 0; x < 3; ++x)
                least[x] = std::min(least[x], points[i][x]), most[x] = std::max(most[x], points[i][x]);
        int longest = 0;
        for (int x = 1; x < 3; ++x)
            if (most[x] - least[x] > most[longest] - least[longest]) longest = x;
        const std::size_t middle = begin + ((end - begin) / 2 + neighbours - 1) / neighbours * neighbours;
        const auto at = [&](std::size_t i) { return points.begin() + static_cast<std::ptrdiff_t>(i); };
        std::nth_element(at(begin), at(middle), at(end),
                         [&](const Triple& a, const Triple& b) { return a[longest] < b[longest]; });
        gather(points, begin, middle);
        gather(points, middle, end);
    }

    // The boxes: their middles and half their sides, `width` of them at a time.
    void enclose(const std::vector<Triple>& points) {
        const std::size_t boxes = (count_ + neighbours - 1) / neighbours;
        boxes_.assign((boxes + width - 1) / width * 6 * width, 0.0);
        for (std::size_t box = 0; box < boxes_.size() / 6; ++box) {
            double* into = boxes_.data() + box / width * 6 * width + box % width;
            for (int x = 0; x < 3; ++x) {
                if (box >= boxes) {  // none: it is never looked into
                    into[(3 + x) * width] = -std::numeric_limits<double>::infinity();
                    continue;
                }
                double least = points[box * neighbours][x], most = least;
                for (std::size_t i = box * neighbours; i < std::min(count_, (box + 1) * neighbours); ++i)
                    least = std::min(least, points[i][x]), most = std::max(most, points[i][x]);
                into[x * width] = 0.5 * (least + most);
                into[(3 + x) * width] = 0.5 * (most - least);
            }
        }
    }

    Triple few_corner(const Triple& along) const {
        const double* own = blocks_.data();
        double most = -std::numeric_limits<double>::infinity();
        std::size_t best = 0;
        for (std::size_t i = 0; i < count_; ++i) {
            const double far = own[i] * along[0] + own[width + i] * along[1] + own[2 * width + i] * along[2];
            best = far > most ? i : best;
            most = far > most ? far : most;
        }
        return point(best);
    }

    Triple stretch(const Triple& along) const {
        const Triple stretched{radii_[0] * along[0], radii_[1] * along[1], radii_[2] * along[2]};
        const double size = length(stretched);
        if (size == 0.0) return {};
        return (1.0 / size) * Triple{radii_[0] * stretched[0], radii_[1] * stretched[1], radii_[2] * stretched[2]};
    }

    Triple radii_{};
    bool ball_ = true;
    std::size_t count_ = 0;
    std::vector<double> blocks_;  // of `width` points each: their x, y and z
    std::vector<double> boxes_;   // around neighbours
};

// A point of the difference of two solids, and that of the first solid in it.
struct Difference {
    Triple point, own;
};

// Two solids, and the second's frame in that of the first; the difference of their cores.
struct Couple {
    const Solid &one, &other;
    Frame there;

    double round() const { return one.round() + other.round(); }
    Difference farthest(const Triple& along) const {
        const Triple own = one.farthest_of_core(along);
        return {own - there.act(other.farthest_of_core(there.turn_back(-1.0 * along))), own};
    }
};

// Points of a difference of solids, at most four, of which the origin is nearest to a point of all of them.
class Simplex {
public:
    // Takes a point in, leaves those out that the nearest point does not need; the nearest point.
    Difference nearest_with(const Difference& point) {
        corners_[count_++] = point;
        const int all = count_;
        double least = std::numeric_limits<double>::infinity();
        Difference found{};
        int kept = 1;
        // Few enough to try every face, edge and corner that has the new point.
        for (int others = 0; others < 1 << (all - 1); ++others) {
            const int members = others | 1 << (all - 1);
            Difference near;
            if (!inside(members, near)) continue;
            if (const double size = dot(near.point, near.point); size < least)
                least = size, found = near, kept = members;
        }
        count_ = 0;
        for (int i = 0; i < all; ++i)
            if (kept >> i & 1) corners_[count_++] = corners_[i];
        return found;
    }

    bool full() const { return count_ == 4; }
    int count() const { return count_; }
    const Difference& corner(int i) const { return corners_[i]; }

private:
    // The point nearest to the origin in the plane of some corners, and whether it lies between them.
    bool inside(int members, Difference& near) const {
        const Difference* at[4] = {};
        int n = 0;
        for (int i = 0; i < count_; ++i)
            if (members >> i & 1) at[n++] = &corners_[i];
        if (n == 3) face_longest(at);
        near = *at[0];
        if (n == 1) return true;
        const Triple &first = at[0]->point, a = at[1]->point - first;
        if (n == 4) {  // the origin is inside, if anywhere
            near.point = {};
            const Triple b = at[2]->point - first, c = at[3]->point - first, o = -1.0 * first;
            const double volume = dot(a, cross(b, c));
            if (volume == 0.0) return false;
            const double x = dot(o, cross(b, c)) / volume, y = dot(a, cross(o, c)) / volume,
                         z = dot(a, cross(b, o)) / volume;
            return x >= 0.0 && y >= 0.0 && z >= 0.0 && x + y + z <= 1.0;
        }
        const double aa = dot(a, a), ao = -dot(a, first);
        if (n == 2) {
            if (!(aa > 0.0)) return false;
            const double x = ao / aa;
            near.point = near.point + x * a;
            near.own = near.own + x * (at[1]->own - at[0]->own);
            return x >= 0.0 && x <= 1.0;
        }
        if (!(aa > 0.0)) return false;
        const Triple b = at[2]->point - first;
        const double share = dot(a, b) / aa;
        const Triple off = b - share * a;
        const double size = dot(off, off);
        if (!(size > 0.0)) return false;
        const double y = -dot(off, first) / size, x = ao / aa - y * share;
        near.point = near.point + x * a + y * b;
        near.own = near.own + x * (at[1]->own - at[0]->own) + y * (at[2]->own - at[0]->own);
        return x >= 0.0 && y >= 0.0 && x + y <= 1.0;
    }

    // Puts that corner of a triangle first from which its shorter sides go: of round surfaces two corners may be so
    // near each other that the sides to both from a distant one are nearly the same.
    static void face_longest(const Difference* (&at)[4]) {
        const Triple a = at[1]->point - at[0]->point, b = at[2]->point - at[0]->point, c = at[2]->point - at[1]->point;
        const double aa = dot(a, a), bb = dot(b, b), cc = dot(c, c);
        if (bb > cc && bb >= aa)
            std::swap(at[0], at[1]);
        else if (aa > cc)
            std::swap(at[0], at[2]);
    }

    Difference corners_[4];
    int count_ = 0;
};

// How well a gap is to be known.
struct Precision {
    double near, off;  // to that share of it, and so many more [m]
    int most;          // steps
};
constexpr Precision roughly{1e-3, 1e-8, 40}, closely{1e-10, 1e-15, 200};

// A plane between two solids, or the nearest points of their cores; as seen from the first.
struct Parting {
    double distance = -std::numeric_limits<double>::infinity();  // they are at least so far apart [m]
    Triple normal{1.0, 0.0, 0.0};                                // of the plane, from the first to the second
    Difference nearest{};
    double size = std::numeric_limits<double>::infinity();  // of what is between these
    Simplex simplex;
};

// Between which points of their cores two solids were nearest, each as its own solid sees it.
class Footing {
public:
    void keep(const Couple& couple, const Simplex& simplex) {
        count_ = simplex.count();
        for (int i = 0; i < count_; ++i) {
            const Difference& corner = simplex.corner(i);
            own_[i] = corner.own, other_[i] = couple.there.act_back(corner.own - corner.point);
        }
    }
    // The nearest point of the difference there; false where there is none, or it is too near.
    bool stand(const Couple& couple, double off, Simplex& simplex, Difference& nearest) const {
        for (int i = 0; i < count_; ++i)
            nearest = simplex.nearest_with({own_[i] - couple.there.act(other_[i]), own_[i]});
        const bool clear = count_ > 0 && dot(nearest.point, nearest.point) > off * off;
        if (!clear) simplex = {};
        return clear;
    }

private:
    Triple own_[3], other_[3];
    int count_ = 0;
};

// The widest gap between two solids; whatever rounding does, there is that much. Begun along a unit vector, or where
// they were nearest before, which is kept, and ended where the gap is wider than `beyond`.
inline Parting part(const Couple& couple, Triple along, const Precision& precision,
                    double beyond = std::numeric_limits<double>::infinity(), Footing* footing = nullptr) {
    Parting found;
    const double round = couple.round();
    if (footing && footing->stand(couple, precision.off, found.simplex, found.nearest)) {
        found.size = length(found.nearest.point);
        along = (-1.0 / found.size) * found.nearest.point;
    }
    for (int i = 0; i < precision.most; ++i) {
        const Difference w = couple.farthest(along);
        const double gap = -dot(w.point, along) - round;
        if (gap > found.distance) found.distance = gap, found.normal = along;
        if (found.distance > beyond) break;
        const double left = found.size - round - found.distance;
        if (left <= precision.near * std::max(found.distance, 0.0) + precision.off) break;
        const Difference next = found.simplex.nearest_with(w);
        const double size = length(next.point);
        if (found.simplex.full()) {
            found.size = 0.0;
            break;
        }
        if (!(size < found.size)) break;
        found.nearest = next, found.size = size;
        if (!(size > precision.off)) break;
        along = (-1.0 / size) * next.point;
    }
    if (footing && !found.simplex.full()) footing->keep(couple, found.simplex);
    return found;
}

// The unit vector along another one; of nothing, any.
inline Triple unit_along(const Triple& way) {
    const double size = length(way);
    return size > 0.0 ? (1.0 / size) * way : Triple{1.0, 0.0, 0.0};
}

// A unit vector from about the middle of one solid to that of another.
inline Triple towards(const Couple& couple) {
    return unit_along(couple.there.act(couple.other.point(0)) - couple.one.point(0));
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
