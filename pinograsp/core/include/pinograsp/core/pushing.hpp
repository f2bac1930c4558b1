// An object that parts of a hand push: it makes way without friction, until friction may jam it between them.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "approach.hpp"
#include "body.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

using Seven = std::array<double, 7>;

inline double dot(const Seven& a, const Seven& b) {
    double found = 0.0;
    for (int i = 0; i < 7; ++i) found += a[i] * b[i];
    return found;
}
inline void add(Seven& a, double s, const Seven& b) {
    for (int i = 0; i < 7; ++i) a[i] += s * b[i];
}

// The multiples of vectors, none of them negative, that come nearest to a target (Lawson and Hanson, 1974).
class Shares {
public:
    // What is left: the multiples' sum less the target.
    Seven nearest(const std::vector<Seven>& vectors, const Seven& target) {
        const std::size_t n = vectors.size();
        shares_.assign(n, 0.0), barred_.assign(n, 0), taken_.clear();
        Seven left = target;  // the other way round
        for (std::size_t turn = 0; turn < 3 * n + 10 && taken_.size() < 7; ++turn) {
            std::size_t best = n;
            double most = least;
            for (std::size_t j = 0; j < n; ++j)
                if (const double slope = dot(vectors[j], left); !barred_[j] && slope > most) most = slope, best = j;
            if (best == n) break;
            taken_.push_back(best), barred_[best] = 1;
            if (!settle(vectors, target)) continue;  // it is of no use beside the others
            left = target;
            for (std::size_t j : taken_) add(left, -shares_[j], vectors[j]);
            std::fill(barred_.begin(), barred_.end(), 0);
            for (std::size_t j : taken_) barred_[j] = 1;
        }
        for (double& one : left) one = -one;
        return left;
    }

private:
    static constexpr double least = 1e-12, alike = 1e-9;

    // Shares of what is taken; false where those with the last one are no better, which is left out again.
    bool settle(const std::vector<Seven>& vectors, const Seven& target) {
        const std::size_t last = taken_.back();
        for (bool first = true;; first = false) {
            const std::size_t n = taken_.size();
            if (first && (!solve(vectors, target) || !(found_[n - 1] > 0.0))) {
                taken_.pop_back();
                return false;
            }
            if (!first && !solve(vectors, target)) return true;
            double way = 1.0;
            for (std::size_t i = 0; i < n; ++i)
                if (const double now = shares_[taken_[i]]; !(found_[i] > 0.0))
                    way = std::min(way, now / (now - found_[i]));
            std::size_t kept = 0;
            for (std::size_t i = 0; i < n; ++i) {
                double& share = shares_[taken_[i]];
                share += way * (found_[i] - share);
                if (found_[i] > 0.0 || share > least || taken_[i] == last)
                    taken_[kept++] = taken_[i];
                else
                    share = 0.0;
            }
            const bool all = kept == n;
            taken_.resize(kept);
            if (all) return true;
        }
    }

    // Least squares of what is taken, by Gram and Schmidt's method, twice; false where vectors depend on each other.
    bool solve(const std::vector<Seven>& vectors, const Seven& target) {
        const std::size_t n = taken_.size();
        Seven left = target;
        for (std::size_t j = 0; j < n; ++j) {
            Seven& own = across_[j] = vectors[taken_[j]];
            const double size = std::sqrt(dot(own, own));
            for (std::size_t i = 0; i < j; ++i) rows_[i][j] = 0.0;
            for (int again = 0; again < 2; ++again)
                for (std::size_t i = 0; i < j; ++i) {
                    const double part = dot(across_[i], own);
                    rows_[i][j] += part;
                    add(own, -part, across_[i]);
                }
            rows_[j][j] = std::sqrt(dot(own, own));
            if (!(rows_[j][j] > alike * size)) return false;
            for (double& one : own) one /= rows_[j][j];
            found_[j] = dot(own, left);
            add(left, -found_[j], own);
        }
        for (std::size_t j = n; j-- > 0;) {
            for (std::size_t i = j + 1; i < n; ++i) found_[j] -= rows_[j][i] * found_[i];
            found_[j] /= rows_[j][j];
        }
        return true;
    }

    std::vector<double> shares_;
    std::vector<char> barred_;
    std::vector<std::size_t> taken_;
    std::array<Seven, 7> across_;
    std::array<std::array<double, 7>, 7> rows_;
    std::array<double, 7> found_;
};

// How a push goes, as in pinograsp.contacts.closing and pinograsp.contacts.pushing.
struct PushSettings {
    double step, caged, room, leverage, far;  // [-], [m], and shares; how far at most [of the object's radius]
    double rather_moved, balanced;
    int most, cuts;
};

// A part of the hand that may push, the finger that it is of, and a bound of its speed [m per unit of the way].
struct Pusher {
    int part, finger;
    double speed;
};

class Pushing {
public:
    struct PushPart {
        int joint;  // -1: fixed in the world
        Frame frame;
        Body body;
    };

    std::vector<Joint> joints;  // parents first
    std::vector<PushPart> parts;
    Body object;          // in a frame at its centre of mass
    double radius = 0.0;  // of the ball around it there [m]
    PushSettings settings{};

    // Goes on with the joints q (n) at `rate` to `last` (n), the object at `there`, from `at` on the way. All three are
    // where it ends.
    void push(std::vector<double>& q, const double* rate, const double* last, Frame& there, double& at,
              const std::vector<Pusher>& pushers, double friction) {
        double step = settings.step, most = step, room = 0.0, fastest = 0.0;
        for (const Pusher& one : pushers) fastest = std::max(fastest, one.speed);
        const Triple start = there.t;
        // Lower bounds: how far off distant parts are is not computed.
        std::vector<double> gaps(pushers.size(), -std::numeric_limits<double>::infinity()), next;
        std::vector<double> trial(q.size());
        near_.assign(parts.size(), {});
        bool pushed = true;
        for (int turn = 0; turn < settings.most; ++turn) {
            if (pushed && is_jammed(q, there, pushers, gaps, friction, std::max(settings.caged, 2.0 * room))) {
                if (2.0 * room <= settings.caged) return;
                most = step = 0.25 * std::min(step, most);  // nearer, before it is called touching
            }
            if (step * fastest < 0.1 * settings.caged) return;
            double left = 0.0;
            for (std::size_t i = 0; i < q.size(); ++i) {
                const double own = std::fabs(last[i] - q[i]);
                left = std::max(left, own);
                trial[i] = q[i] + std::copysign(std::min(step * std::fabs(rate[i]), own), rate[i]);
            }
            if (!(left > 1e-12)) return;
            const double reach = step * fastest, given = std::max(0.1 * settings.caged, settings.room * reach);
            next = gaps;
            for (std::size_t i = 0; i < next.size(); ++i) next[i] -= step * pushers[i].speed;
            Frame moved = there;
            pushed = make_way(trial, pushers, moved, next, settings.leverage * reach + given, given);
            if (!pushed) {
                step *= 0.25;
                continue;
            }
            q = trial, gaps = next, there = moved, at += step, room = given;
            step = std::min(2.0 * step, most);
            if (length(there.t - start) > settings.far * radius) return;  // pushed out of the hand
        }
    }

private:
    static constexpr Seven last_one{0, 0, 0, 0, 0, 0, 1.0};

    // What of a part is nearest to the object, in the world, or how deep inside.
    struct Touch {
        double gap;
        Triple point, normal;
    };

    void place(const std::vector<double>& q) {
        placed_.resize(joints.size());
        place_joints(joints, q.data(), placed_);
    }

    Touch look(int which, const Frame& there) {
        constexpr double clear = 1e-6;  // [m]
        const PushPart& part = parts[which];
        const Frame frame = part.joint < 0 ? part.frame : placed_[part.joint] * part.frame;
        Frame seen = frame.inverse() * there;
        Separation gap = nearest(which, seen);
        const double distance = gap.distance;
        // Of what overlaps the points are those that are nearest when it has just left.
        if (!(gap.apart > 0.0)) {
            seen.t = seen.t + (clear - distance) * gap.normal;
            const Separation outside = nearest(which, seen);
            if (outside.apart > 0.0) gap.mine = outside.mine;
        }
        return {distance, frame.act(gap.mine), frame.turn(gap.normal)};
    }

    // Begun where they were nearest before.
    Separation nearest(int which, const Frame& seen) {
        const Body& body = parts[which].body;
        const Triple along = unit_along(seen.t - body.bounds().middle);
        return Nearest(body, object, seen, along, std::numeric_limits<double>::max(), true, &near_[which]).gap;
    }

    // Moves the object out of the way of the joints at q, as little as possible; false where it cannot yield. `gaps`:
    // bounds before, and after. It moves by `far` at most, and by half of `room` more than it must.
    bool make_way(const std::vector<double>& q, const std::vector<Pusher>& pushers, Frame& there,
                  std::vector<double>& gaps, double far, double room) {
        const double arm = settings.rather_moved * radius;
        Triple shift{}, turn{};  // the latter times the arm
        rows_.clear();
        place(q);
        const Frame from = there;
        for (int cut = 0; cut < settings.cuts; ++cut) {
            bool overlaps = false;
            for (std::size_t i = 0; i < pushers.size(); ++i) {
                if (!(gaps[i] < 0.0)) continue;
                const Touch touch = look(pushers[i].part, there);
                gaps[i] = touch.gap;
                overlaps |= touch.gap < 0.0;
                const Triple around = (1.0 / arm) * cross(touch.point - there.t, touch.normal);
                const double side = 0.5 * room - touch.gap + dot(touch.normal, shift) + dot(around, turn);
                rows_.push_back(
                    {touch.normal[0], touch.normal[1], touch.normal[2], around[0], around[1], around[2], side});
            }
            if (!overlaps) return true;
            Triple other, other_turn;
            if (!find_least(other, other_turn)) return false;
            if (!(length(other) + length(other_turn) * radius / arm <= far)) return false;
            const double by = length(other - shift) + length(other_turn - turn) * radius / arm;
            for (double& gap : gaps) gap -= by;
            shift = other, turn = other_turn;
            there = rotate_by((1.0 / arm) * turn) * Frame{from.R, {}};
            there.t = from.t + shift;
        }
        return false;
    }

    // The least motion with normal . shift + around . turn >= side in each row (least distance programming).
    bool find_least(Triple& shift, Triple& turn) {
        double scale = 1e-12;
        for (const Seven& row : rows_) scale = std::max(scale, std::fabs(row[6]));
        scaled_ = rows_;
        for (Seven& row : scaled_) row[6] /= scale;
        const Seven left = shares_.nearest(scaled_, last_one);
        if (!(dot(left, left) >= 1e-14) || !(left[6] < 0.0)) return false;
        for (int x = 0; x < 3; ++x) shift[x] = -left[x] / left[6] * scale, turn[x] = -left[3 + x] / left[6] * scale;
        return true;
    }

    // Whether forces within the friction cones of parts that are `near` add up to nothing.
    bool is_jammed(const std::vector<double>& q, const Frame& there, const std::vector<Pusher>& pushers,
                   std::vector<double>& gaps, double friction, double near) {
        rows_.clear();
        place(q);
        int one = -1;
        bool others = false;
        for (std::size_t i = 0; i < pushers.size(); ++i) {
            if (!(gaps[i] <= near)) continue;
            const Touch touch = look(pushers[i].part, there);
            gaps[i] = touch.gap;
            if (!(touch.gap <= near)) continue;
            others |= !rows_.empty() && pushers[i].finger != one;
            one = pushers[i].finger;
            const Triple x = across(touch.normal), y = cross(touch.normal, x);
            for (int edge = 0; edge < 8; ++edge) {
                const double angle = 0.78539816339744831 * edge;
                const Triple force = touch.normal + friction * (std::cos(angle) * x + std::sin(angle) * y);
                const Triple moment = (1.0 / radius) * cross(touch.point - there.t, force);
                rows_.push_back({force[0], force[1], force[2], moment[0], moment[1], moment[2], 1.0});
            }
        }
        if (!others) return false;
        const Seven left = shares_.nearest(rows_, last_one);
        return dot(left, left) < settings.balanced * settings.balanced;
    }

    std::vector<Frame> placed_;
    std::vector<NearestPieces> near_;
    std::vector<Seven> rows_, scaled_;
    Shares shares_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
