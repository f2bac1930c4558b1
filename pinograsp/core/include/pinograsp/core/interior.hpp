// The interior-point method for every force problem whose objective has no products of two contacts: polyhedral and
// second-order friction cones, bounds on F_n, powers of F_n, the largest F_n, quadratic terms and torque rows.
//
// The iterates stay inside the cones and bounds; balance and torque rows hold in the limit. With B = [A; R],
// multipliers l = [y; w] and per contact the Hessian H_i of the objective and of the barriers, a Newton step solves
//
//     [ H  B' ] [dx]   [ -stationarity + centring ]
//     [ B  -E ] [dl] = [ -rows                    ],     H block diagonal with blocks (d, d), E = diag(0, s/w),
//
// by the Schur complement B H^-1 B' + E: six unknowns and one for each torque row, whatever the number of contacts, so
// the cost of a step grows linearly with it. Steps (steps.hpp) are Mehrotra's predictor and corrector (1992). In
// infeasible problems the multipliers grow along a Farkas certificate, and are tested as one while they grow.
#pragma once

#include "steps.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// For problems of k contacts with d components, the first `round` of them in second-order cones, and of a number of
// facets, m rows of the balance and r torque rows. Takes its memory when it is made; none after that.
class Interior {
public:
    // `peak`: the largest F_n may be in the objective.
    Interior(int d, int round, int facets, int k, int m, int r, bool peak = false)
        : room_(d, round, facets, k, m, r, peak) {}

    // x (d k) and y (m + r) are results. With give > 0 the balance may be missed at a cost of |A x - b|^2 / (2 give).
    // Infeasible: y is a Farkas certificate.
    Code solve(const Problem& problem, double give, double* x, double* y, int& steps) {
        return of_shape(room_.d, room_.round, [&](auto shape) {
            return iterate<decltype(shape)::D, decltype(shape)::R>(problem, give, x, y, steps);
        });
    }

private:
    static constexpr int most_steps = 60;
    static constexpr double interior_gap = 1e-8;  // relative gap at which the search ends
    static constexpr double closed = 1e-7;        // at which it may end once rounding stops its progress
    static constexpr double held = 1e-9;          // residual of balance and torque rows, relative to the load
    // Share of the way to the boundary of polyhedral and of second-order cones.
    static constexpr double to_boundary = 0.999, to_second_order = 0.98;
    // Multipliers larger than this, relative to the objective, are tested as a certificate.
    static constexpr double much = 30.0;

    // Where the search is.
    struct State {
        double far = 0.0, value = 0.0, scale = 0.0;  // residual of the rows, the objective, its size
        double products = 0.0;                       // sum of the complementarity
        double previous = infinity;                  // the last gap
        double grown = 0.0, tested = much;           // size of the multipliers, and at which they are tested next
        int short_steps = 0;                         // in a row
    };

    template <int D, int R>
    Code iterate(const Problem& problem, double give, double* x, double* y, int& steps) {
        const Step<D, R> step{room_, problem, give};
        const int count = (room_.facets + 2 + (R > 0 ? 1 : 0) + (room_.topped ? 1 : 0)) * room_.k + 2 * room_.r;
        const double share = R > 0 ? to_second_order : to_boundary;
        State now;
        step.read();
        step.first_point();
        for (steps = 0; steps < most_steps; ++steps) {
            now.far = step.missed();
            now.value = step.objective();
            now.scale = max(std::fabs(now.value), 1e-6);
            for (int r = 0; r < room_.m; ++r) now.scale += give * room_.y[r] * room_.y[r];
            now.products = step.factorise();
            write(x, y);
            if (found(problem, give, now, x, y)) {
                if (give == 0.0) step.balance_again();
                write(x, y);
                copy(room_.best_y, y, room_.rows);
                return Code::converged;
            }
            now.grown = 0.0;
            for (int r = 0; r < room_.rows; ++r) now.grown = max(now.grown, std::fabs(y[r]));
            if (!(now.grown < 1e15 && now.products < 1e15)) return Code::stalled;
            if (give == 0.0 && certified(problem, now, y)) return Code::infeasible;
            const double alpha = min(1.0, share * step.predict_and_correct(now.products, count, share));
            now.short_steps = alpha < 1e-3 ? now.short_steps + 1 : 0;
            if (now.short_steps > 5) return Code::stalled;
            step.advance(alpha);
        }
        return Code::stalled;
    }

    // Whether the search ends here, or at the last point whose gap was measured. The point's multipliers are kept.
    bool found(const Problem& problem, double give, State& now, const double* x, double* y) {
        if (!(now.far <= (give == 0.0 ? 1e-7 : 1e-9) && now.products <= 1e-6 * now.scale)) return false;
        double gap = now.value - bound_of(problem, x, y).bound;
        // The cost of restoring the balance, or of missing it.
        for (int r = 0; r < room_.m; ++r) gap += y[r] * (room_.row[r] + give * y[r]);
        bool done = gap <= now.scale * interior_gap, back = false;
        if (!done && gap >= 0.3 * now.previous && min(gap, now.previous) <= now.scale * closed) {
            done = true;  // rounding stops its progress
            back = now.previous < gap;
        }
        const int bytes = room_.length * int(sizeof(Vector));
        if (back) {
            std::memcpy(room_.x, room_.best, bytes);
        } else {
            std::memcpy(room_.best, room_.x, bytes);
            copy(y, room_.best_y, room_.rows);
        }
        now.previous = gap;
        return done;
    }

    // Whether multipliers that have grown prove that there are no forces; y becomes the certificate.
    bool certified(const Problem& problem, State& now, double* y) const {
        const double size = max(now.scale, 1.0);
        const bool stuck = now.short_steps > 1 && now.grown > 0.0;
        if (!(now.far > held && (now.grown > now.tested * size || stuck))) return false;
        now.tested = max(now.tested, 4.0 * now.grown / size);
        for (int r = 0; r < room_.rows; ++r) y[r] /= now.grown;
        return excluded(problem, y) > proven;
    }

    // Forces and multipliers as the caller sees them.
    void write(double* x, double* y) const {
        const int k = room_.k;
        for (int j = 0; j < room_.d; ++j) copy(numbers(room_.x + j * room_.blocks), x + j * k, k);
        copy(room_.y, y, room_.rows);
    }

    static void copy(const double* from, double* to, int count) {
        for (int l = 0; l < count; ++l) to[l] = from[l];
    }

    Room room_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
