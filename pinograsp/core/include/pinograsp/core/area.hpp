// Areas in which convex solids meet when they are pressed together.
#pragma once

#include <array>
#include <cmath>

#include "convex.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// What two faces have in common, seen along the normal: corners in the plane through the point where they touch. One
// that counts is the middle of what is smaller than a millimetre, two are the ends of an edge. `leaning`: by how much
// the faces are farther apart there than where they are nearest.
struct Area {
    static constexpr int most = 4;
    std::array<Triple, most> corners;
    int count;
    std::array<double, most> leaning;
};

class CommonArea {
public:
    // `one`, `other`: empty where of a solid only the point is known. `lean`: of faces against each other, at most.
    CommonArea(const Solid* one, const Frame& at, const Solid* other, const Frame& there, const Triple& point,
               const Triple& normal, double lean)
        : point_(point), normal_(normal), x_(across(normal)), y_(cross(normal, x_)) {
        constexpr double pi = 3.14159265358979323846;
        for (int i = 0; i < around; ++i) {
            const double azimuth = 0.3 + pi / 4.0 * i;  // askew, since along an edge any of its points is as near
            way_[i] = {std::cos(azimuth), std::sin(azimuth)};
            const Triple aside = std::sin(lean) * (way_[i][0] * x_ + way_[i][1] * y_);
            const Triple ahead = std::cos(lean) * normal;
            if (one) a_.add(*this, i, at.act(one->farthest(at.turn_back(aside + ahead))) - point);
            if (other) b_.add(*this, i, there.act(other->farthest(there.turn_back(aside - ahead))) - point);
            if (!one) a_.add(*this, i, {});
            if (!other) b_.add(*this, i, {});
        }
    }

    Area find() const {
        constexpr double none = -std::numeric_limits<double>::infinity();
        // The farthest in each of four directions: all corners of a rectangle, whichever way it lies.
        std::array<Flat, Area::most> best{};
        std::array<double, Area::most> far{none, none, none, none};
        const auto take = [&](const Flat& candidate) {
            for (int k = 0; k < Area::most; ++k)
                if (const double own = candidate[0] * way_[2 * k][0] + candidate[1] * way_[2 * k][1]; own > far[k])
                    far[k] = own, best[k] = candidate;
        };
        for (const Flat& corner : a_.at)
            if (b_.has(corner)) take(corner);
        for (const Flat& corner : b_.at)
            if (a_.has(corner)) take(corner);
        for (int i = 0; i < around; ++i)
            for (int j = 0; j < around; ++j) cross_edges(i, j, take);
        return finish(best);
    }

private:
    static constexpr int around = 8;
    static constexpr double wider = 1e-4;  // [m] so that points and edges have an inside
    static constexpr double same = 1e-3;   // [m] corners nearer to each other are one
    using Flat = std::array<double, 2>;

    static double turn(const Flat& a, const Flat& b) { return a[0] * b[1] - a[1] * b[0]; }
    static Flat between(const Flat& a, const Flat& b) { return {b[0] - a[0], b[1] - a[1]}; }

    // The points of a solid that are farthest along the tilted normals, in the plane and along the normal.
    struct Face {
        std::array<Flat, around> at, own;  // enlarged, and as they are
        std::array<double, around> height;

        void add(const CommonArea& area, int i, const Triple& arm) {
            own[i] = {dot(arm, area.x_), dot(arm, area.y_)};
            at[i] = {own[i][0] + wider * area.way_[i][0], own[i][1] + wider * area.way_[i][1]};
            height[i] = dot(arm, area.normal_);
        }
        Flat edge(int i) const { return between(at[i], at[(i + 1) % around]); }
        bool has(const Flat& point) const {
            for (int i = 0; i < around; ++i)
                if (!(turn(edge(i), between(at[i], point)) >= -1e-12)) return false;
            return true;
        }
        // How it rises along the normal: the plane through its points, the least that fits.
        Flat slope() const {
            Flat middle{};
            double level = 0.0;
            for (int i = 0; i < around; ++i)
                middle[0] += own[i][0] / around, middle[1] += own[i][1] / around, level += height[i] / around;
            double xx = same * same, yy = same * same, xy = 0.0, xh = 0.0, yh = 0.0;
            for (int i = 0; i < around; ++i) {
                const Flat off = between(middle, own[i]);
                const double rise = height[i] - level;
                xx += off[0] * off[0], yy += off[1] * off[1], xy += off[0] * off[1];
                xh += off[0] * rise, yh += off[1] * rise;
            }
            const double size = xx * yy - xy * xy;
            return {(yy * xh - xy * yh) / size, (xx * yh - xy * xh) / size};
        }
    };

    template <class Take>
    void cross_edges(int i, int j, const Take& take) const {
        const Flat a = a_.edge(i), b = b_.edge(j), off = between(a_.at[i], b_.at[j]);
        const double angle = turn(a, b);
        if (!(std::fabs(angle) > 1e-15)) return;
        const double s = turn(off, b) / angle, r = turn(off, a) / angle;
        if (s >= 0.0 && s <= 1.0 && r >= 0.0 && r <= 1.0) take({a_.at[i][0] + s * a[0], a_.at[i][1] + s * a[1]});
    }

    Area finish(const std::array<Flat, Area::most>& best) const {
        Area found{};
        Flat middle{};
        for (const Flat& corner : best) middle[0] += corner[0] / Area::most, middle[1] += corner[1] / Area::most;
        std::array<Flat, Area::most> kept{middle, middle, middle, middle};
        for (const Flat& corner : best) {
            bool apart = true;
            for (int i = 0; i < found.count; ++i) {
                const Flat off = between(kept[i], corner);
                apart = apart && std::sqrt(off[0] * off[0] + off[1] * off[1]) > same;
            }
            if (apart) kept[found.count++] = corner;
        }
        if (found.count == 1) kept[0] = middle;
        const Flat up = b_.slope(), down = a_.slope();
        double lowest = std::numeric_limits<double>::infinity();
        for (int i = 0; i < Area::most; ++i) {
            found.corners[i] = point_ + kept[i][0] * x_ + kept[i][1] * y_;
            found.leaning[i] = (up[0] - down[0]) * kept[i][0] + (up[1] - down[1]) * kept[i][1];
            if (i < found.count) lowest = std::min(lowest, found.leaning[i]);
        }
        for (double& one : found.leaning) one = std::max(one - lowest, 0.0);
        return found;
    }

    Triple point_, normal_, x_, y_;
    std::array<Flat, around> way_;
    Face a_, b_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
