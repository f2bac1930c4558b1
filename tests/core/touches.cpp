// Random and hostile solids, hands and objects: a plane parts what is apart, no way out is shorter than the one that is
// found, and whatever the numbers are, nothing is read or written outside of its array. Usage: touches seed count.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <vector>

#include "pinograsp/core.hpp"

using namespace pinograsp::core;

namespace {

unsigned long long input = 0;
std::mt19937_64 random_bits;

[[noreturn]] void fail(const char* what, double own, double other) {
    std::fprintf(stderr, "touches: input %llu, %s: %.17g, %.17g\n", input, what, own, other);
    std::abort();
}

int below(int count) { return static_cast<int>(random_bits() % static_cast<unsigned>(count)); }
double spread(double size) { return size * (2.0 * std::ldexp(static_cast<double>(random_bits() >> 11), -53) - 1.0); }

// One in so many numbers is one that nobody expects; 0: none.
double number(double size, int hostile) {
    constexpr double none = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
    constexpr double values[] = {none, inf, -inf, 0.0, 1e300, -1e300, 1e-300, 5e-324, 1e12, -1e-12};
    return hostile > 0 && below(hostile) == 0 ? values[below(10)] : spread(size);
}
Triple triple(double size, int hostile) {
    return {number(size, hostile), number(size, hostile), number(size, hostile)};
}
Frame frame(double size, int hostile) {
    Frame found = below(4) == 0 ? Frame{} : rotate_by(triple(3.0, hostile));
    if (below(8) > 0) found.t = triple(size, hostile);
    return found;
}

// Few points, which may be the same, or lie on a line or in a plane, and what is about them.
std::vector<Triple> some_points(int hostile, int least) {
    std::vector<Triple> points;
    const int flat = below(6), more = below(8), count = least + below(more == 0 ? 1000 : more < 3 ? 40 : 9);
    for (int i = 0; i < count; ++i) {
        Triple point = triple(0.05, hostile);
        for (int x = 0; x < 3; ++x)
            if (flat > 2 && x >= flat - 2) point[x] = 0.0;
        if (below(4) == 0)
            for (double& x : point) x = std::copysign(0.02, x);
        points.push_back(point);
    }
    return points;
}

Solid solid(int hostile, int least) {
    const std::vector<Triple> points = some_points(hostile, least);
    const double radius = below(2) == 0 ? 0.0 : std::fabs(number(0.03, hostile));
    Triple radii{radius, radius, radius};
    if (below(3) == 0) radii[2] = 0.0;
    if (below(3) == 0) radii[1] = std::fabs(number(0.03, hostile));
    return Solid(points, radii);
}

// How far the second solid must go along a direction to leave the first.
double way_out(const Couple& couple, const Triple& along) {
    return dot(couple.farthest(along).point, along) + couple.round();
}

// However many points there are, the farthest is that of all of them.
void check_farthest() {
    const std::vector<Triple> points = some_points(0, 1);
    const Solid one(points, {});
    for (int i = 0; i < 20; ++i) {
        const Triple along = i == 0 ? Triple{0.0, 0.0, -1.0} : triple(1.0, 0);
        double most = dot(points[0], along);
        for (const Triple& point : points) most = std::max(most, dot(point, along));
        const double found = dot(one.farthest(along), along);
        if (!(std::fabs(found - most) <= 1e-15)) fail("not the farthest point", found, most);
    }
}

void check_pair() {
    const Solid one = solid(0, 1), other = solid(0, 1);
    const Couple couple{one, other, frame(below(2) == 0 ? 0.02 : 0.2, 0)};
    const Separation found = measure(couple, towards(couple), std::numeric_limits<double>::max());
    const double size = length(found.normal);
    if (!(std::fabs(size - 1.0) < 1e-12)) fail("the normal's length", size, 1.0);
    const double out = way_out(couple, found.normal);
    if (std::fabs(out + found.distance) > 2e-8) fail("no plane is so far from both", -out, found.distance);
    if (found.apart > 0.0) {
        const Triple off = found.other - found.mine - found.distance * found.normal;
        if (!(length(off) < 1e-5)) fail("points that are not so far apart", length(off), found.distance);
        return;
    }
    for (int i = 0; i < 50; ++i) {
        Triple along = i < 6 ? Triple{} : triple(1.0, 0);
        if (i < 6) along[i / 2] = i & 1 ? 1.0 : -1.0;
        const double other_way = way_out(couple, (1.0 / length(along)) * along);
        if (other_way < -found.distance - 1e-6 - 1e-5 * other_way) fail("a shorter way out", other_way, -found.distance);
    }
    const Separation rough = measure(couple, towards(couple), 0.0, false);
    if (!(rough.distance <= 0.0)) fail("an overlap that is none", rough.distance, found.distance);
}

// Solids that move a little are as far apart whether the search begins where they were nearest before or not.
void check_footing() {
    constexpr double most = std::numeric_limits<double>::max();
    const Solid one = solid(0, 1), other = solid(0, 1);
    Frame there = frame(below(2) == 0 ? 0.05 : 0.2, 0);
    Footing footing;
    for (int i = 0; i < 20; ++i) {
        const Couple couple{one, other, there};
        const Separation found = measure(couple, towards(couple), most, true, &footing);
        const Separation afresh = measure(couple, towards(couple), most);
        const double off = std::fabs(found.distance - afresh.distance);
        if (!(off <= 2e-8 + 1e-5 * std::max(0.0, -afresh.distance)))
            fail("another gap from where they were nearest", found.distance, afresh.distance);
        there = there * rotate_by(triple(i % 5 == 4 ? 1.0 : 0.02, 0));
        there.t = there.t + triple(i % 5 == 4 ? 0.05 : 1e-3, 0);
    }
}

void check_scene() {
    const int hostile = below(2) == 0 ? 0 : 20;
    TouchScene scene;
    scene.inputs = 1 + below(4);
    for (int j = below(6); j > 0; --j) {
        const int before = static_cast<int>(scene.joints.size());
        const bool slides = below(2) == 0;
        scene.joints.push_back({below(before + 1) - 1, below(scene.inputs), frame(0.1, hostile),
                                slides ? triple(1.0, hostile) : Triple{}, slides ? Triple{} : triple(1.0, hostile)});
        scene.loads.push_back({number(1.0, hostile), triple(0.1, hostile)});
    }
    const auto body = [hostile] {
        std::vector<Solid> pieces;
        for (int i = below(4) == 0 ? below(30) : 1; i > 0; --i) pieces.push_back(solid(hostile, below(10) == 0 ? 0 : 1));
        return Body(std::move(pieces));
    };
    for (int i = 1 + below(5); i > 0; --i)
        scene.parts.push_back({below(static_cast<int>(scene.joints.size()) + 1) - 1, frame(0.1, hostile),
                               below(static_cast<int>(scene.parts.size()) + 1), body(),
                               below(3) == 0 ? body() : Body{}});
    const int parts = static_cast<int>(scene.parts.size());
    for (int i = below(6); i > 0; --i) scene.pairs.push_back({below(parts), below(parts)});
    for (int i = 1 + below(4); i > 0; --i) scene.solids.emplace_back(solid(hostile, 1));
    if (scene.solids.size() > 1 || below(3) == 0) scene.surface = body();
    scene.root = frame(0.1, hostile), scene.object = frame(0.1, hostile);
    Touches found;
    Toucher toucher(scene);
    const std::size_t postures = 3;
    const bool follows = below(2) == 0;
    for (std::size_t i = 0; i < postures; ++i) {
        const Triple values = triple(1.0, hostile);
        const double q[4] = {values[0], values[1], values[2], 0.0};
        const Frame root = frame(0.1, hostile);
        TouchOptions options{below(2) == 0 ? 2e-3 : std::fabs(number(0.05, hostile)), 0.03, {0.0, 0.0, -9.81}};
        options.deepest = below(2) == 0 ? options.tolerance : 0.02;
        options.follows = follows, options.hulls = below(2) == 0;
        toucher.touch(q, root, options, found);
        const double gap = toucher.gap(q, root, {0, parts - 1}, 0.1);
        if (hostile == 0 && !(gap <= 0.1)) fail("a gap beyond its bound", gap, 0.1);
    }
    const std::size_t t = found.gap.size();
    if (found.depth.size() != postures || found.failed.size() != postures || found.collision.size() != postures ||
        found.gravity.size() != postures * scene.inputs || found.points.size() != 3 * t ||
        found.corners.size() != 12 * t || found.jacobians.size() != 6 * t * scene.inputs)
        fail("sizes that differ", static_cast<double>(t), static_cast<double>(found.depth.size()));
    if (hostile > 0) return;
    for (double one : found.jacobians)
        if (!std::isfinite(one)) fail("a Jacobian that is not finite", one, 0.0);
}

// No triangle is nearer to a point than the one that is found, whatever the numbers are.
void check_triangles() {
    const int hostile = below(3) > 0 ? 0 : 20, count = below(40);
    std::vector<Triple> corners;
    for (int i = 0; i < 3 * count; ++i)
        corners.push_back(i > 0 && below(4) == 0 ? corners[below(i)] : triple(below(2) == 0 ? 0.1 : 0.01, hostile));
    Triangles triangles(corners);
    const Triple point = count > 0 && below(4) == 0 ? corners[below(3 * count)] : triple(0.2, hostile);
    const NearestTriangle found = triangles.find_nearest(point, 1e-9);
    if (found.triangle < -1 || found.triangle >= count || found.foot.feature < 0 || found.foot.feature > 6)
        fail("no such triangle", static_cast<double>(found.triangle), count);
    if (hostile > 0 || count == 0) return;
    if (found.triangle < 0) fail("nothing is near", 0.0, count);
    const auto distance = [&](std::int64_t i) {  // by another method, from above
        double least = std::numeric_limits<double>::infinity();
        for (int a = 0; a <= 60; ++a)
            for (int b = 0; a + b <= 60; ++b) {
                const Triple at = (a / 60.0) * corners[3 * i] + (b / 60.0) * corners[3 * i + 1] +
                                  ((60 - a - b) / 60.0) * corners[3 * i + 2];
                least = std::min(least, length(point - at));
            }
        return least;
    };
    // Half of a side of the mesh of points more than it is.
    const double nearest = distance(found.triangle), told = length(found.foot.at - point);
    double longest = 0.0;
    if (std::fabs(told - std::sqrt(found.foot.squared)) > 1e-12) fail("another distance", told, found.foot.squared);
    for (std::size_t i = 0; i < corners.size(); ++i)
        longest = std::max(longest, length(corners[i] - corners[i % 3 == 2 ? i - 2 : i + 1]));
    for (int i = 0; i < count; ++i)
        if (const double other = distance(i); other + 1e-9 < nearest - longest / 60.0 || other + 1e-12 < told)
            fail("a nearer triangle", other, told);
    if (told < nearest - longest / 60.0 - 1e-12) fail("a point of no triangle", told, nearest);
}

// No multiples are nearer: what is left is across what is taken, and no vector points away from it.
void check_shares() {
    std::vector<Seven> vectors(below(3) == 0 ? below(100) : below(9));
    for (Seven& one : vectors)
        for (double& x : one) x = below(4) == 0 ? 0.0 : spread(1.0);
    if (vectors.size() > 1 && below(3) == 0) vectors.back() = vectors.front();
    Seven target{};
    target[6] = 1.0;
    const Seven left = Shares().nearest(vectors, target);
    double off = dot(left, left) + left[6];
    for (const Seven& one : vectors) off = std::max(off, -dot(one, left));
    if (!(off <= 1e-8)) fail("nearer multiples", off, dot(left, left));
}

// A hand that pushes ends where nothing overlaps, no farther than its joints go, whatever the numbers are.
void check_push() {
    const int hostile = below(2) == 0 ? 0 : 20;
    Pushing push;
    push.settings = {0.005, 2e-6, 0.02, 10.0, 4.0, 3.0, 1e-3, 200, 30};
    push.joints.push_back({-1, 0, frame(0.1, hostile), triple(1.0, hostile), {}});
    push.joints.push_back({below(2) - 1, below(2), frame(0.05, hostile), {}, triple(1.0, hostile)});
    const int count = 1 + below(3);
    std::vector<Pusher> pushers;
    for (int i = 0; i < count; ++i) {
        push.parts.push_back({below(3) - 1, frame(0.05, hostile), Body(solid(hostile, 1))});
        pushers.push_back({i, below(3), std::fabs(number(2.0, hostile))});
    }
    push.object = Body(solid(hostile, 1));
    push.radius = std::fabs(number(0.2, hostile)) + 1e-3;
    const Triple first = triple(0.5, hostile), rates = triple(1.0, hostile);
    std::vector<double> q{first[0], first[1]};
    const double last[2] = {q[0] + 0.2 * rates[0], q[1] + 0.2 * rates[1]};
    Frame there = frame(0.3, hostile);
    double at = 0.0;
    push.push(q, rates.data(), last, there, at, pushers, 0.5);
    if (hostile > 0) return;
    for (int i = 0; i < 2; ++i)
        if (!(std::fabs(q[i] - last[i]) <= std::fabs(first[i] - last[i]) + 1e-12)) fail("too far", q[i], last[i]);
    if (!(at >= 0.0)) fail("the way that was gone", at, 0.0);
}

// A depth is that of a way out, and its point the object's, whatever the numbers are.
void check_depth() {
    const int hostile = below(2) == 0 ? 0 : 20;
    const Body part(solid(hostile, 1)), object(solid(hostile, 1));
    const Frame at = frame(0.02, hostile), there = frame(0.03, hostile);
    Triple normal = triple(1.0, hostile);
    if (hostile == 0) normal = (1.0 / length(normal)) * normal;
    const DepthSearch how{1e-3, 0.05, 1e-7, below(2) == 0 ? 0.0 : 1e-4, number(0.01, hostile), 20};
    const Depth found = find_depth(part, at, object, there, normal, how);
    if (hostile > 0 || !found.found) return;
    if (std::fabs(length(found.normal) - 1.0) > 1e-9) fail("the normal of a depth", length(found.normal), 1.0);
    // Moved off by a depth along its normal, the two overlap no more than the direction was still turning.
    Frame moved = there;
    moved.t = there.t + (found.depth + 1e-3) * found.normal;
    const double gap = Nearest(part, object, at.inverse() * moved, found.normal, 1.0).gap.distance;
    if (!(gap > -0.05)) fail("no way out", gap, found.depth);
}

}  // namespace

int main(int count, char** arguments) {
    if (count < 3) return std::fprintf(stderr, "usage: touches seed count\n"), 2;
    const unsigned long long first = std::strtoull(arguments[1], nullptr, 10),
                             most = std::strtoull(arguments[2], nullptr, 10);
    for (input = first; input < first + most; ++input) {
        random_bits.seed(input);
        check_farthest();
        check_pair();
        check_footing();
        check_scene();
        check_triangles();
        check_shares();
        check_depth();
        check_push();
    }
    std::printf("touches of %llu inputs hold\n", most);
    return 0;
}
