// Lower bounds of the objective, and proofs that a load cannot be held, from multipliers of the rows.
#pragma once

#include "lanes.hpp"
#include "powers.hpp"
#include "problem.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// A lower bound of the objective, and the objective.
struct Bound {
    double bound, value;
};

// max of g . u over U, of `width` contacts.
PINOGRASP_INLINE Vector support(const Friction& friction, const Vector* g) {
    Vector total = 0.0;
    int j = friction.round;
    if (friction.round > 0) {
        for (int a = 0; a < friction.round; ++a) total = total + g[a] * g[a];
        total = sqrt(total);
    } else if (friction.corners > 0) {
        total = -infinity;
        for (int v = 0; v < friction.corners; ++v) {
            const double* corner = friction.vertices + 2 * v;
            total = max(total, Vector(corner[0]) * g[0] + Vector(corner[1]) * g[1]);
        }
        j = 2;
    }
    for (; j < friction.d - 1; ++j) total = total + Vector(friction.radii[j]) * abs(g[j]);
    return total;
}

// The next `width` of `left` numbers, zeros after the last.
PINOGRASP_INLINE Vector next_of(const double* from, int left) {
    if (left >= width) return lanes_at(from);
    double part[width] = {};
    for (int l = 0; l < left; ++l) part[l] = from[l];
    return lanes_at(part);
}

// The powers of F_n: adds them to the value, their tangent to the bound and to the slopes s. A tangent nearer to the
// minimiser of phi(F) + s F proves more where F lies between its bounds; `alone`: where nothing else depends on F.
PINOGRASP_INLINE void add_powers(const Powers& powers, Vector F, Vector lo, Vector hi, bool alone, Vector& s,
                                 Vector& bound, Vector& value, Vector live) {
    const Vector zero = 0.0;
    F = max(F, Vector(1e-300));
    Phi<Vector> own = phi(F, powers.count, powers.coefficients, powers.exponents);
    value = value + live * own.value;
    const auto curved = own.second > zero;
    if (alone && any(curved)) {
        const Vector step = (s + own.first) / select(curved, own.second, Vector(1.0));
        const Vector better = min(max(F - step, max(lo, Vector(0.5) * F)), hi);
        F = select(curved, better, F);
        own = phi(F, powers.count, powers.coefficients, powers.exponents);
    }
    s = s + own.first;
    bound = bound + live * (own.value - own.first * F);
}

// Weights of F_n whose sum is the peak's: the largest F_n is at least the weighted mean. They cancel negative slopes,
// first of contacts below their largest force (at the others the bound is sharp anyway); what remains goes to the
// contact with the largest lower bound.
struct Peak {
    static constexpr double near = 1e-3, capped = 1e-6;
    double most = 0.0, wanted[2] = {}, scale[2] = {}, rest = 0.0;
    int least = 0;  // the contact with the largest lower bound

    double want_of(double s, double F) const { return F > most * (1.0 - near) ? max(-s, 0.0) : 0.0; }
    static bool is_capped(const Problem& problem, int i, double F) { return F >= problem.hi[i] * (1.0 - capped); }

    void want(const Problem& problem, Vector s, int i, const double* x) {
        for (int l = 0; l < width && i + l < problem.k; ++l) {
            const double F = x[(problem.friction.d - 1) * problem.k + i + l];
            wanted[is_capped(problem, i + l, F)] += want_of(in_lane(s, l), F);
            if (problem.lo[i + l] > problem.lo[least]) least = i + l;
        }
    }

    void share(double peak) {
        rest = peak;
        for (int part = 0; part < 2; ++part) {
            const double taken = min(wanted[part], rest);
            scale[part] = wanted[part] > 0.0 ? taken / wanted[part] : 0.0;
            rest -= taken;
        }
    }

    Vector weights(const Problem& problem, Vector s, int i, const double* x) const {
        Vector found = 0.0;
        for (int l = 0; l < width && i + l < problem.k; ++l) {
            const double F = x[(problem.friction.d - 1) * problem.k + i + l];
            in_lane(found, l) =
                scale[is_capped(problem, i + l, F)] * want_of(in_lane(s, l), F) + (i + l == least ? rest : 0.0);
        }
        return found;
    }
};

// See below; without `objective` it counts as zero, and x is not read.
template <bool objective>
inline Bound bound_with(const Problem& problem, const double* x, const double* y) {
    const Friction& friction = problem.friction;
    const int k = problem.k, d = friction.d, n = d * k, e = d - 1;
    double fixed = 0.0;
    for (int r = 0; r < problem.m; ++r) fixed -= y[r] * problem.b[r];
    for (int r = 0; r < problem.r; ++r) {
        const double w = y[problem.m + r];
        fixed -= max(w * problem.R_hi[r], w * problem.R_lo[r]);
    }
    Vector bound = 0.0, value = 0.0;
    Peak peak;
    // The slopes of F_n of the contacts from i on; parts of bound and value that are not theirs are added up.
    const auto slopes = [&](int i, Vector* own) {
        const int left = k - i;
        Vector g[4];
        for (int j = 0; j < d; ++j) {
            Vector t = 0.0;
            if constexpr (objective) own[j] = next_of(x + j * k + i, left);
            for (int row = 0; row < problem.m + problem.r; ++row)
                t = t + Vector(y[row]) * next_of(problem.B + row * n + j * k + i, left);
            g[j] = t;
        }
        if constexpr (objective)
            for (int j = 0; j < d; ++j) {
                Vector t = 0.0;
                const Vector q = next_of(problem.q + j * k + i, left);
                for (int c = 0; c < d; ++c) t = t + next_of(problem.P + (j * d + c) * k + i, left) * own[c];
                bound = bound - Vector(0.5) * t * own[j];
                value = value + (q + Vector(0.5) * t) * own[j];
                g[j] = g[j] + t + q;
            }
        const Vector lo = next_of(problem.lo + i, left), hi = next_of(problem.hi + i, left);
        Vector s = g[e] - support(friction, g);
        // Lanes after the last contact have hi = 0.
        if constexpr (objective)
            if (problem.powers.count > 0)
                add_powers(problem.powers, own[e], lo, hi, problem.peak == 0.0, s, bound, value,
                           select(hi > Vector(0.0), Vector(1.0), Vector(0.0)));
        return s;
    };
    Vector own[4];
    if (objective && problem.peak > 0.0) {
        for (int i = 0; i < k; ++i) peak.most = max(peak.most, x[e * k + i]);
        for (int i = 0; i < k; i += width) peak.want(problem, slopes(i, own), i, x);
        peak.share(problem.peak);
        bound = value = 0.0;
    }
    for (int i = 0; i < k; i += width) {
        Vector s = slopes(i, own);
        if (objective && problem.peak > 0.0) s = s + peak.weights(problem, s, i, x);
        bound = bound + min(next_of(problem.lo + i, k - i) * s, next_of(problem.hi + i, k - i) * s);
    }
    return {fixed + sum(bound), sum(value) + problem.peak * peak.most};
}

// Lower bound of the objective from multipliers y (m + r) of the rows and tangents near x (d k), and the objective at
// x.
//
// The Lagrangian with P linearised at x is linear in every contact's x_i but for phi(F_n): its least value over
// friction and F_n is min(lo s, hi s), where s is the slope of F_n less the support of the others.
inline Bound bound_of(const Problem& problem, const double* x, const double* y) {
    return bound_with<true>(problem, x, y);
}

// Farkas bound of multipliers y (m + r): positive, no admissible forces balance the load within the torque limits.
inline double excluded(const Problem& problem, const double* y) { return bound_with<false>(problem, nullptr, y).bound; }

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
