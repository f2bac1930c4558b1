// One step of the interior-point method (interior.hpp).
//
// Contacts are side by side in lanes: entry j blocks + b is component j of the contacts of block b. Those that fill up
// the last block do not count; neither do the torque rows that fill up theirs. Where a number of theirs could become
// anything but neutral, it is multiplied by `live`, which is zero for them.
#pragma once

#include <type_traits>

#include "bounds.hpp"
#include "memory.hpp"
#include "second_order.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// All that a solve works in.
//
// Limits, in this order: facets of the cones (one block after the other for each facet), F_n, torque rows. Arrays of
// slacks hold their lower sides, then the upper ones, which facets do not have, then how far each F_n is below the top,
// an unknown of its own that stands for the largest F_n where that is in the objective.
struct Room {
    int d, round, facets, k, m, r;
    bool topped;  // whether there is a top
    int rows = m + r, blocks = blocks_of(k), row_blocks = blocks_of(r), length = d * blocks;
    int normal = facets * blocks, torque = normal + blocks;  // where in the limits those on F_n begin, and torque rows
    int limits = torque + row_blocks, up = limits - normal;  // how far it is to an upper side
    int below = limits + up, slacks = below + (topped ? blocks : 0);
    double top = 0.0, top_step = 0.0, top_pivot = 1.0;
    bool quadratic = false;  // whether the objective has quadratic terms

    Room(int d_, int round_, int facets_, int k_, int m_, int r_, bool topped_)
        : d(d_), round(round_), facets(facets_), k(k_), m(m_), r(r_), topped(topped_) {
        each([&](auto*& part, std::size_t count) {
            part = memory_.template part<std::remove_reference_t<decltype(*part)>>(count);
        });
        for (int l = 0; l < slacks; ++l) {
            const bool rowwise = l < below && l >= torque && (l < limits || l >= limits + blocks);
            const int block = l < torque   ? l % blocks
                              : l >= below ? l - below
                              : rowwise    ? (l - torque) % up
                                           : l - limits;
            const int left = (rowwise ? r : k) - block * width;
            for (int lane = 0; lane < width; ++lane) numbers(live + l)[lane] = lane < left ? 1.0 : 0.0;
        }
        for (int i = 0; i < blocks * width; ++i) numbers(hi)[i] = 2.0;
    }

    // Lanes of the torque rows of an array of limits or of lower sides, one after the other.
    double* rows_of(Vector* array) const { return numbers(array + torque); }

    // The problem: rows, bounds, objective.
    Vector *B = nullptr, *lo = nullptr, *hi = nullptr, *P = nullptr, *q = nullptr;
    // Of all slacks: slacks s, multipliers z, their steps, weights w = z / s, 1 / s, s less the true slack, products of
    // the predictor's steps, target of a step.
    Vector *s = nullptr, *z = nullptr, *ds = nullptr, *dz = nullptr, *w = nullptr, *inverse = nullptr;
    Vector *off = nullptr, *product = nullptr, *target = nullptr, *live = nullptr;
    // Per limit, both sides together: values along a vector, and weights.
    Vector *along = nullptr, *weights = nullptr;
    // What the top adds to T (blocks), to the Schur complement, and that divided by it (rows).
    Vector* top_T = nullptr;
    double* stiff = nullptr;  // steps of the torque rows from those of their multipliers
    double *top_S = nullptr, *top_solved = nullptr;
    // Forces, their step, the gradient; the last forces whose gap was measured.
    Vector *x = nullptr, *dx = nullptr, *gradient = nullptr, *best = nullptr;
    // Hessians of the contacts, then their factors; T = H^-1/2 B'.
    Vector *H = nullptr, *T = nullptr;
    // Multipliers of the second-order cones, their steps, the centring term; scalings.
    Vector *cone_z = nullptr, *cone_dz = nullptr, *centring = nullptr, *scaling = nullptr;
    // Residual of the balance (m); multipliers of all rows, their step, those of `best`, zeros; Schur complement.
    double *row = nullptr, *y = nullptr, *dy = nullptr, *best_y = nullptr, *zeros = nullptr, *S = nullptr;

private:
    template <class F>
    void each(F take) {
        const auto all = [&](std::size_t count, auto*&... parts) { (take(parts, count), ...); };
        const std::size_t cones = round > 0 ? std::size_t(round + 1) * blocks : 0, n = rows;
        all(n * length, B, T);
        all(blocks, lo, hi);
        all(std::size_t(d * (d + 1) / 2) * blocks, P, H);
        all(length, q, x, dx, gradient, best);
        all(slacks, s, z, ds, dz, w, inverse, off, product, target, live);
        all(limits, along, weights);
        all(topped ? blocks : 0, top_T);
        all(topped ? n : 0, top_S, top_solved);
        all(cones, cone_z, cone_dz, centring);
        all(round > 0 ? cones + blocks : 0, scaling);
        all(n, row, y, dy, best_y, zeros);
        all(n * n, S);
        all(r, stiff);
    }

    Memory memory_;
};

// A step for forces of D components, the first R of them in second-order cones.
template <int D, int R>
struct Step {
    static constexpr int E = D - 1;
    static constexpr double start = 0.6;  // first F_n, relative to the load over the root of the number of contacts
    static constexpr double centre =
        0.3;  // first product of slack and multiplier, relative to the objective per contact
    // Least centring, relative to the mean product: products far apart would cost the last digits.
    static constexpr double least_centre = 1e-3;

    Room& at;
    const Problem& problem;
    const double give;

    // Copies the problem into lanes.
    void read() const {
        const int k = at.k, row = at.blocks * width;
        const auto copy = [&](const double* from, Vector* to, int count) {
            for (int j = 0; j < count; ++j) std::memcpy(numbers(to) + j * row, from + j * k, k * sizeof(double));
        };
        copy(problem.B, at.B, at.rows * D);
        copy(problem.q, at.q, D);
        copy(problem.lo, at.lo, 1);
        copy(problem.hi, at.hi, 1);
        at.quadratic = false;
        for (int l = 0; l < D * D * k; ++l) at.quadratic |= problem.P[l] != 0.0;
        if (at.quadratic)
            for (int j = 0; j < D; ++j) copy(problem.P + (j * D + j) * k, at.P + upper<D>(j, j) * at.blocks, D - j);
    }

    // Forces along the normals, within their bounds, with slacks and multipliers of a given product.
    void first_point() const {
        const double mu = centre / at.k;
        for (int b = 0; b < at.blocks; ++b) {
            const Vector lo = at.lo[b], hi = at.hi[b], wide = hi - lo;
            const Vector least = max(Vector(start / std::sqrt(double(at.k))), lo + Vector(0.1) * min(wide, 1.0 / at.k));
            const Vector F = min(least, hi - Vector(0.1) * wide);
            for (int j = 0; j < E; ++j) at.x[j * at.blocks + b] = 0.0;
            at.x[E * at.blocks + b] = F;
            if constexpr (R > 0)
                for (int j = 0; j <= R; ++j) at.cone_z[b * (R + 1) + j] = j < R ? Vector(0.0) : Vector(mu) / F;
        }
        for (int r = 0; r < at.rows; ++r) at.y[r] = 0.0;
        limits_along(at.x);
        for (int l = 0; l < at.slacks; ++l) at.off[l] = 0.0;
        for (int l = 0; l < at.normal; ++l) at.s[l] = at.along[l];
        for (int b = 0; b < at.blocks; ++b) {
            const int l = at.normal + b;
            at.s[l] = at.along[l] - at.lo[b];
            at.s[l + at.up] = at.hi[b] - at.along[l];
        }
        at.top = at.top_step = 0.0;
        if (at.topped) {
            Vector most = 0.0;
            for (int b = 0; b < at.blocks; ++b) most = max(most, at.live[at.below + b] * at.along[at.normal + b]);
            at.top = 2.0 * largest(most);
            for (int b = 0; b < at.blocks; ++b) {
                const Vector live = at.live[at.below + b];
                at.s[at.below + b] = select(live > Vector(0.0), Vector(at.top) - at.along[at.normal + b], Vector(1.0));
            }
        }
        const double* along = at.rows_of(at.along);
        for (int r = 0; r < at.row_blocks * width; ++r) {
            const double least = r < at.r ? problem.R_lo[r] : -1.0, most = r < at.r ? problem.R_hi[r] : 1.0;
            const double value = r < at.r ? along[r] : 0.0;  // after the last row: what the last problem left there
            first_slack(r, value - least, most - least, 0);
            first_slack(r, most - value, most - least, at.up);
        }
        for (int l = 0; l < at.slacks; ++l) at.z[l] = Vector(mu) * at.live[l] / at.s[l];
    }

    // The residual of the balance, in `row`; returns the largest residual of balance and torque rows.
    double missed() const {
        double far = 0.0;
        for (int r = 0; r < at.m; ++r) {
            at.row[r] = balance(r) - give * at.y[r];
            far = max(far, std::fabs(at.row[r]));
        }
        Vector most = 0.0;
        for (int l = 0; l < at.row_blocks; ++l)
            most = max(most, max(abs(at.off[at.torque + l]), abs(at.off[at.torque + at.up + l])));
        return max(far, largest(most));
    }

    // The objective at x; its gradient and Hessian.
    double objective() const {
        const Powers& powers = problem.powers;
        const int blocks = at.blocks;
        Vector value = 0.0;
        for (int b = 0; b < blocks; ++b) {
            const Vector *P = at.P + b, *x = at.x + b, *q = at.q + b;
            Vector *H = at.H + b * triangle<D>, *gradient = at.gradient + b;
            for (int j = 0; j < D; ++j) {
                Vector t = 0.0;
                for (int c = j; c < D; ++c) H[upper<D>(j, c)] = 0.0;
                if (at.quadratic)
                    for (int c = 0; c < D; ++c) {
                        const int entry = c < j ? upper<D>(c, j) : upper<D>(j, c);
                        t = t + P[entry * blocks] * x[c * blocks];
                        if (c >= j) H[entry] = P[entry * blocks];
                    }
                gradient[j * blocks] = q[j * blocks] + t;
                value = value + (q[j * blocks] + Vector(0.5) * t) * x[j * blocks];
            }
            if (powers.count > 0) {
                const auto own = phi(x[E * blocks], powers.count, powers.coefficients, powers.exponents);
                const Vector live = at.live[at.normal + b];
                value = value + live * own.value;
                gradient[E * blocks] = gradient[E * blocks] + live * own.first;
                H[upper<D>(E, E)] = H[upper<D>(E, E)] + live * own.second;
            }
        }
        return sum(value) + problem.peak * at.top;
    }

    // Adds the barriers to the Hessian, factors it and the Schur complement; returns the sum of the complementarity.
    double factorise() const {
        Vector products = 0.0;
        for (int l = 0; l < at.slacks; ++l) {
            at.inverse[l] = at.live[l] / at.s[l];
            at.w[l] = at.z[l] * at.inverse[l];
            products = products + at.s[l] * at.z[l];
        }
        both_sides(at.w, 1.0, at.weights);
        double tops = 0.0;  // weight of the top, the forces and multipliers eliminated
        for (int b = 0; b < at.blocks; ++b) {
            Vector H[triangle<D>];
            for (int l = 0; l < triangle<D>; ++l) H[l] = at.H[b * triangle<D> + l];
            add_weighted_limits(b, H);
            if constexpr (R > 0) products = products + scale_cones(b, H);
            factor_contacts<D>(H);
            for (int l = 0; l < triangle<D>; ++l) at.H[b * triangle<D> + l] = H[l];
            if (at.topped) {
                // F_n is the last to be eliminated: its pivot alone takes the weight of the top.
                const Vector w = at.w[at.below + b];
                Vector& scale = at.H[b * triangle<D> + upper<D>(E, E)];
                const Vector pivot = Vector(1.0) / (scale * scale), both = Vector(1.0) / (pivot + w);
                tops += sum(w * pivot * both);
                scale = H[upper<D>(E, E)] = sqrt(both);
                at.top_T[b] = w * scale;
            }
            for (int r = 0; r < at.rows; ++r) {
                Vector v[D];
                for (int j = 0; j < D; ++j) v[j] = at.B[r * at.length + j * at.blocks + b];
                half_solve<D>(H, v);
                for (int j = 0; j < D; ++j) at.T[r * at.length + j * at.blocks + b] = v[j];
            }
        }
        inner_products(at.T, at.T, at.rows, at.length, at.S);
        const double* weights = at.rows_of(at.weights);
        for (int r = 0; r < at.rows; ++r) at.S[r * (at.rows + 1)] += r < at.m ? give : 1.0 / weights[r - at.m];
        factor(at.S, at.rows);
        if (at.topped) {
            for (int r = 0; r < at.rows; ++r)
                at.top_S[r] = at.top_solved[r] = dot(at.T + r * at.length + E * at.blocks, at.top_T, at.blocks);
            solve(at.S, at.top_solved, at.rows);
            for (int r = 0; r < at.rows; ++r) tops += at.top_S[r] * at.top_solved[r];
            at.top_pivot = max(tops, 1e-300);
        }
        return sum(products);
    }

    // Mehrotra's step, of forces, slacks and multipliers; returns how far one may go, up to 1 / share. `products`: the
    // sum of the `count` products of slacks and multipliers.
    double predict_and_correct(double products, int count, double share) const {
        add_combination(at.B, at.rows, at.length, at.y, 1.0, at.gradient);
        double alpha = 1.0, wanted = 0.0;
        for (int pass = 0; pass < 2; ++pass) {
            const bool corrector = pass == 1;
            const Vector centred = wanted;
            for (int l = 0; l < at.slacks; ++l) {
                at.target[l] = at.w[l] * at.off[l];
                if (corrector) at.target[l] = at.target[l] + (centred - at.product[l]) * at.inverse[l];
            }
            for (int l = 0; l < at.length; ++l) at.dx[l] = -at.gradient[l];
            if constexpr (R > 0)
                for (int b = 0; b < (corrector ? at.blocks : 0); ++b)
                    for (int j = 0; j <= R; ++j) {
                        Vector& out = at.dx[(j < R ? j : E) * at.blocks + b];
                        out = out + at.centring[b * (R + 1) + j];
                    }
            both_sides(at.target, -1.0, at.along);
            Vector push = 0.0;
            for (int b = 0; b < (at.topped ? at.blocks : 0); ++b) {
                const Vector own = at.target[at.below + b];
                at.along[at.normal + b] = at.along[at.normal + b] - own;
                push = push + own;
            }
            newton_step(at.y, sum(push) - problem.peak);
            limits_along(at.dx);
            // Where a torque row is all but fixed, rounding in its step would count in its multiplier many times.
            for (int t = 0; t < at.r; ++t)
                if (at.rows_of(at.weights)[t] > 1.0) at.rows_of(at.along)[t] = at.stiff[t];
            alpha = steps_of_slacks(corrector ? 1.0 / share : 1.0);
            if constexpr (R > 0) alpha = step_cones(corrector, alpha);
            if (!corrector) {
                for (int l = 0; l < at.slacks; ++l) at.product[l] = at.ds[l] * at.dz[l];
                const double short_of = 1.0 - alpha;
                wanted = max(short_of * short_of * short_of, least_centre) * products / count;
                if constexpr (R > 0) centre_cones(wanted);
            }
        }
        return alpha;
    }

    // Takes the step. Slacks are carried along: computed from x they would lose their digits, and could vanish.
    void advance(double alpha) const {
        const Vector a = alpha, rest = 1.0 - alpha;
        for (int l = 0; l < at.slacks; ++l) {
            at.s[l] = at.s[l] + a * at.ds[l];
            at.z[l] = at.z[l] + a * at.dz[l];
            at.off[l] = at.off[l] * rest;
        }
        for (int l = 0; l < at.length; ++l) at.x[l] = at.x[l] + a * at.dx[l];
        at.top += alpha * at.top_step;
        if constexpr (R > 0)
            for (int l = 0; l < (R + 1) * at.blocks; ++l) at.cone_z[l] = at.cone_z[l] + a * at.cone_dz[l];
        for (int r = 0; r < at.m; ++r) at.y[r] += alpha * at.dy[r];
        const double *low = at.rows_of(at.z), *high = at.rows_of(at.z + at.up);
        for (int r = 0; r < at.r; ++r) {
            at.y[at.m + r] = high[r] - low[r];
            // What the slacks are off: measured, as rounding adds up.
            const double value = dot(at.B + (at.m + r) * at.length, at.x, at.length);
            at.rows_of(at.off)[r] = at.rows_of(at.s)[r] - (value - problem.R_lo[r]);
            at.rows_of(at.off + at.up)[r] = at.rows_of(at.s + at.up)[r] - (problem.R_hi[r] - value);
        }
    }

    // Removes the residual that rounding leaves in the rows, in the barriers' metric: in it forces at their limits
    // hardly move.
    void balance_again() const {
        for (int pass = 0; pass < 2; ++pass) {
            for (int l = 0; l < at.slacks; ++l) at.target[l] = pass > 0 ? Vector(0.0) : at.w[l] * at.off[l];
            both_sides(at.target, -1.0, at.along);
            for (int l = 0; l < at.length; ++l) at.dx[l] = 0.0;
            newton_step(at.zeros, 0.0);
            for (int l = 0; l < at.length; ++l) at.x[l] = at.x[l] + at.dx[l];
            for (int r = 0; r < at.m; ++r) at.row[r] = balance(r);
        }
    }

private:
    // How far row r of the balance is from holding.
    double balance(int r) const { return dot(at.B + r * at.length, at.x, at.length) - problem.b[r]; }

    // A torque row's slack on one side; where the true one is too small it is off by the rest.
    void first_slack(int r, double slack, double range, int side) const {
        const double off = max(0.1 * min(range, 1.0) - slack, 0.0);
        at.rows_of(at.off + side)[r] = off;
        at.rows_of(at.s + side)[r] = slack + off;
    }

    // out: the lower side of each limit plus `sign` times its upper one.
    void both_sides(const Vector* v, double sign, Vector* out) const {
        for (int l = 0; l < at.normal; ++l) out[l] = v[l];
        for (int l = at.normal; l < at.limits; ++l) out[l] = v[l] + Vector(sign) * v[l + at.up];
    }

    // Values of all limits along v, in `along`.
    void limits_along(const Vector* v) const {
        const double* C = problem.friction.C;
        for (int b = 0; b < at.blocks; ++b) {
            const Vector F = v[E * at.blocks + b];
            at.along[at.normal + b] = F;
            for (int a = 0; a < at.facets; ++a) {
                Vector t = F;
                for (int j = 0; j < E; ++j) t = t - Vector(C[a * E + j]) * v[j * at.blocks + b];
                at.along[a * at.blocks + b] = t;
            }
        }
        double* rows = at.rows_of(at.along);
        for (int r = 0; r < at.r; ++r) rows[r] = dot(at.B + (at.m + r) * at.length, v, at.length);
    }

    // Adds the weighted limits of a block's contacts to their matrices.
    void add_weighted_limits(int b, Vector* H) const {
        for (int a = 0; a < at.facets; ++a) {
            const double* C = problem.friction.C + a * E;
            const Vector w = at.weights[a * at.blocks + b];
            for (int j = 0; j < E; ++j) {
                const Vector own = Vector(C[j]) * w;
                for (int c = j; c < E; ++c) H[upper<D>(j, c)] = H[upper<D>(j, c)] + Vector(C[c]) * own;
                H[upper<D>(j, E)] = H[upper<D>(j, E)] - own;
            }
            H[upper<D>(E, E)] = H[upper<D>(E, E)] + w;
        }
        H[upper<D>(E, E)] = H[upper<D>(E, E)] + at.weights[at.normal + b];
    }

    // Newton steps of forces and multipliers. dx: on entry the right-hand side without the limits' part, which is in
    // `along`, and `push`, that of the top. `y`: multipliers of the torque rows that the right-hand side already has.
    void newton_step(const double* y, double push) const {
        const double *sides = at.rows_of(at.along), *weights = at.rows_of(at.weights), *C = problem.friction.C;
        for (int b = 0; b < at.blocks; ++b) {
            Vector v[D];
            for (int j = 0; j < D; ++j) v[j] = at.dx[j * at.blocks + b];
            v[E] = v[E] + at.along[at.normal + b];
            for (int a = 0; a < at.facets; ++a) {
                const Vector side = at.along[a * at.blocks + b];
                v[E] = v[E] + side;
                for (int j = 0; j < E; ++j) v[j] = v[j] - Vector(C[a * E + j]) * side;
            }
            half_solve<D>(at.H + b * triangle<D>, v);
            for (int j = 0; j < D; ++j) at.dx[j * at.blocks + b] = v[j];
        }
        for (int r = 0; r < at.rows; ++r) {
            const int t = r - at.m;
            at.dy[r] =
                (t < 0 ? at.row[r] : (-sides[t] - y[r]) / weights[t]) + dot(at.T + r * at.length, at.dx, at.length);
        }
        solve(at.S, at.dy, at.rows);
        if (at.topped) {
            push += dot(at.top_T, at.dx + E * at.blocks, at.blocks);
            for (int r = 0; r < at.rows; ++r) push -= at.top_S[r] * at.dy[r];
            at.top_step = push / at.top_pivot;
            for (int r = 0; r < at.rows; ++r) at.dy[r] += at.top_step * at.top_solved[r];
            for (int b = 0; b < at.blocks; ++b) {
                Vector& own = at.dx[E * at.blocks + b];
                own = own + Vector(at.top_step) * at.top_T[b];
            }
        }
        for (int t = 0; t < at.r; ++t) at.stiff[t] = (at.dy[at.m + t] + sides[t] + y[at.m + t]) / weights[t];
        add_combination(at.T, at.rows, at.length, at.dy, -1.0, at.dx);
        for (int b = 0; b < at.blocks; ++b) {
            Vector v[D];
            for (int j = 0; j < D; ++j) v[j] = at.dx[j * at.blocks + b];
            back_solve<D>(at.H + b * triangle<D>, v);
            for (int j = 0; j < D; ++j) at.dx[j * at.blocks + b] = v[j];
        }
    }

    // Steps of slacks and multipliers for the values `along` a step of x; returns the largest step up to alpha that
    // keeps them at least 0.
    double steps_of_slacks(double alpha) const {
        Vector most = alpha;
        for (int l = 0; l < at.slacks; ++l) {
            const Vector along = l < at.limits ? at.along[l]
                                 : l < at.below
                                     ? -at.along[l - at.up]
                                     : at.live[l] * (Vector(at.top_step) - at.along[l - at.below + at.normal]);
            const Vector s = at.s[l], z = at.z[l], ds = along - at.off[l], dz = at.target[l] - z - at.w[l] * along;
            most = select(s + most * ds < Vector(0.0), -s / ds, most);
            most = select(z + most * dz < Vector(0.0), -z / dz, most);
            at.ds[l] = ds;
            at.dz[l] = dz;
        }
        return smallest(most);
    }

    // A block's components of v that second-order cones bound.
    ConeVector<R> in_cone(const Vector* v, int b) const {
        ConeVector<R> found;
        for (int j = 0; j <= R; ++j) found.v[j] = v[(j < R ? j : E) * at.blocks + b];
        return found;
    }

    // A block's entry in an array of the cones.
    static ConeVector<R> entry(const Vector* array, int b) {
        ConeVector<R> found;
        for (int j = 0; j <= R; ++j) found.v[j] = array[b * (R + 1) + j];
        return found;
    }

    static void put(const ConeVector<R>& v, Vector factor, Vector* array, int b) {
        for (int j = 0; j <= R; ++j) array[b * (R + 1) + j] = factor * v.v[j];
    }

    Scaling<R> scaling(int b) const {
        Scaling<R> found;
        for (int j = 0; j <= R; ++j) found.bar.v[j] = at.scaling[b * (R + 2) + j];
        found.size = at.scaling[b * (R + 2) + R + 1];
        return found;
    }

    // Scalings of a block's cones and their Hessians, added to H; returns the complementarity.
    Vector scale_cones(int b, Vector* H) const {
        const ConeVector<R> s = in_cone(at.x, b), z = entry(at.cone_z, b);
        const Scaling<R> own(s, z);
        own.template add_hessian<D>(H);
        for (int j = 0; j <= R; ++j) at.scaling[b * (R + 2) + j] = own.bar.v[j];
        at.scaling[b * (R + 2) + R + 1] = own.size;
        return at.live[at.normal + b] * product(s, z);
    }

    // Steps of the cones' multipliers for the step dx; returns the largest step up to alpha. The predictor leaves its
    // Jordan products in `centring`.
    double step_cones(bool corrector, double alpha) const {
        Vector most = alpha;
        for (int b = 0; b < at.blocks; ++b) {
            const Scaling<R> own = scaling(b);
            const ConeVector<R> v = in_cone(at.dx, b), z = entry(at.cone_z, b);
            const Vector inverse = Vector(1.0) / own.size, live = at.live[at.normal + b];
            const ConeVector<R> ds = own.into(v, inverse), back = own.into(ds, inverse);
            const ConeVector<R> centred = entry(at.centring, b);
            ConeVector<R> dz;
            for (int j = 0; j <= R; ++j) {
                dz.v[j] = -z.v[j] - back.v[j];
                if (corrector) dz.v[j] = centred.v[j] + dz.v[j];
                dz.v[j] = live * dz.v[j];
            }
            if (!corrector) put(jordan(ds, own.times(dz, own.size)), live, at.centring, b);
            put(dz, 1.0, at.cone_dz, b);
            most = to_cone(z, dz, to_cone(in_cone(at.x, b), v, most));
        }
        return smallest(most);
    }

    // Jordan products p in `centring` become W^-1 (lambda \ (centre e - p)), lambda = W z.
    void centre_cones(double wanted) const {
        for (int b = 0; b < at.blocks; ++b) {
            const Scaling<R> own = scaling(b);
            const ConeVector<R> lambda = own.times(entry(at.cone_z, b), own.size);
            const ConeVector<R> found = jordan_quotient(lambda, entry(at.centring, b), Vector(wanted));
            put(own.into(found, Vector(1.0) / own.size), at.live[at.normal + b], at.centring, b);
        }
    }
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
