// The dual Newton method for grasp forces: powers of F_n, objectives without curvature, and loads that cannot be held.
//
// Powers of F_n are replaced by their quadratic models at the last answer, in several passes (sequential quadratic
// programming, whose fixed point solves the prox of phi exactly). Where the objective has no quadratic weight in some
// direction, a proximal weight is added that pulls towards the last answer and falls from pass to pass (Rockafellar
// 1976). The passes end when the duality gap of the original objective is closed.
#pragma once

#include <iterator>

#include "dual.hpp"
#include "powers.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// What a contact's force costs: 1/2 P x^2 + q x, without the powers.
template <class K>
struct Cost {
    Vector P[K::D], q[K::D];
};

// The objective and a lower bound of it.
template <class S>
struct Gap {
    S value, bound;
};

template <class K, class S, class Of = Dual<K, S>>
struct Newton {
    using Truth = typename Of::Truth;

    static constexpr double balanced = 1e-11;  // residual of the balance, relative to the load, in the last pass
    static constexpr double roughly = 1e-2;    // in early passes
    static constexpr int passes = 40, most_steps = 100;
    static constexpr double strong = 0.03;  // objectives of order one with at least this curvature need no more weight
    static constexpr double first_weight = 0.1, shrink = 0.1;  // proximal, from pass to pass
    static constexpr double least_weight = 1e-3,
                            floor = 1e-6;   // at the first pass that may be the last, and at the end
    static constexpr double closed = 1e-9;  // relative gap

    Of dual;
    Cost<K>* costs = nullptr;
    int powers = 0;
    S coefficients[most_powers], exponents[most_powers];

    // The quadratic model of the objective at x, with a proximal weight, in these lanes.
    PINOGRASP_INLINE void model(Truth which, S weight) {
        for (int i = 0; i < dual.count; ++i) {
            Block<K>& at = dual.blocks[i];
            Vector w[K::D], q[K::D];
            for (int j = 0; j < K::D; ++j) {
                w[j] = costs[i].P[j] + Vector(weight);
                q[j] = costs[i].q[j] - Vector(weight) * at.x[j];
            }
            if (powers > 0) {
                const Vector F = at.x[K::E];
                const Phi<Vector> own = phi(F, powers, coefficients, exponents);
                w[K::E] = w[K::E] + own.second;
                q[K::E] = q[K::E] + own.first - own.second * F;
            }
            for (int j = 0; j < K::D; ++j) {
                at.w[j] = select(which, w[j], at.w[j]);
                at.q[j] = select(which, q[j], at.q[j]);
            }
            at.weigh();
        }
    }

    // At x and y; the bound also uses the tangents of the objective at x.
    PINOGRASP_INLINE Gap<S> gap() const {
        Vector value = 0.0, bound = 0.0;
        for (int i = 0; i < dual.count; ++i) {
            const Block<K>& at = dual.blocks[i];
            Vector c[K::D];
            dual.slopes(i, dual.y, c);
            for (int j = 0; j < K::D; ++j) {
                const Vector heavy = costs[i].P[j] * at.x[j];
                c[j] = c[j] + costs[i].q[j] + heavy;
                value = value + (costs[i].q[j] + Vector(0.5) * heavy) * at.x[j];
                bound = bound - Vector(0.5) * heavy * at.x[j];
            }
            if (powers > 0) {
                const Vector F = at.x[K::E];
                const Phi<Vector> own = phi(F, powers, coefficients, exponents);
                value = value + own.value;
                bound = bound + own.value - own.first * F;
                c[K::E] = c[K::E] + own.first;
            }
            bound = bound + at.least(c);
        }
        Gap<S> found{sum_to<S>(value), sum_to<S>(bound)};
        found.bound = found.bound - dual.limits_along(dual.y);
        return found;
    }
};

// Maximise the dual of one problem from its y, in at most `most` steps, until the balance holds to `tolerance`.
template <class Of>
Code ascend(Of& dual, double tolerance, int most, int& steps) {
    dual.begin(true);
    for (int it = 0; it < most; ++it, ++steps) {
        if (dual.residual() <= tolerance) return Code::converged;
        const auto found = dual.step(true, it % Of::patience == Of::patience - 1);  // slow: does y itself diverge?
        if (found.infeasible) return Code::infeasible;
        if (found.stalled) return Code::stalled;
    }
    return dual.residual() <= tolerance ? Code::converged : Code::stalled;
}

// Minimise over the cones from the dual's y and x; these are the results. Infeasible: y is a ray. `least`: the smallest
// entry of P.
template <class K, class Of>
Code minimise(Newton<K, double, Of>& method, double least, int& steps) {
    using N = Newton<K, double, Of>;
    const bool strong = least >= N::strong, once = strong && method.powers == 0;
    double weight = strong ? 0.0 : N::first_weight;
    for (int pass = 0; pass < N::passes; ++pass) {
        const bool last = weight < 2.0 * N::least_weight;
        method.model(true, weight);
        const Code code = ascend(method.dual, last ? N::balanced : N::roughly, N::most_steps, steps);
        if (code != Code::converged || once) return code;
        if (last) {
            const Gap<double> gap = method.gap();
            if (gap.value - gap.bound <= N::closed * max(std::fabs(gap.value), 1e-12)) return Code::converged;
        }
        weight = strong ? 0.0 : max(weight * N::shrink, N::floor);
    }
    return Code::stalled;
}

// The least |A x - b| of all admissible x, with what their other rows miss: infeasible where it is proven, else
// stalled. `best` has room for the forces of all blocks (count, D).
//
// Proximal passes: the weight w of the forces pulls towards the last answer, so it has no influence on the result, and
// the balance gets stiffer from pass to pass. At the end the multipliers prove that no forces leave less.
template <class Of>
Code closest(Of& dual, Vector* best, int most, int& steps) {
    constexpr double first = 0.3, stiffen = 0.5, least_give = 1e-7, sharp = 0.1, near = 1e-8;
    constexpr int passes = 30;
    double nearest = infinity;
    const int before = steps;
    dual.give = first;
    const int rows = dual.rows(), components = int(std::size(dual.blocks[0].x));
    for (int r = 0; r < rows; ++r) dual.y[r] = 0.0;
    for (int i = 0; i < dual.count; ++i)
        for (Vector& one : dual.blocks[i].q) one = 0.0;
    for (int pass = 0; pass < passes; ++pass) {
        ascend(dual, max(sharp * dual.give, 1e-9), most, steps);
        const double off = dual.missed();
        double size = 0.0;
        for (int r = 0; r < rows; ++r) size += dual.y[r] * dual.y[r];
        const double least = dual.least_along(dual.y) / max(std::sqrt(size), 1e-300);
        if (off - least <= near * max(off, 1.0)) {
            dual.give = 0.0;
            return least > proven ? Code::infeasible : Code::stalled;
        }
        const bool better = off < nearest;
        const double stiffer = max(dual.give * stiffen, least_give);
        for (int i = 0; i < dual.count; ++i)
            for (int j = 0; j < components; ++j) {
                auto& at = dual.blocks[i];
                if (better) best[i * components + j] = at.x[j];
                at.q[j] = -at.w[j] * at.x[j];
            }
        nearest = min(off, nearest);
        if (steps - before > 10 * most) break;
        for (int r = 0; r < rows; ++r) dual.y[r] *= dual.give / stiffer;
        dual.give = stiffer;
    }
    for (int i = 0; i < dual.count; ++i)
        for (int j = 0; j < components; ++j) dual.blocks[i].x[j] = best[i * components + j];
    dual.give = 0.0;
    return Code::stalled;
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
