// The dual of a force problem with a separable quadratic objective, and Newton's method on it.
//
// The balance has m = 6 rows, of which the last three are zero where moments do not count; every other constraint
// concerns a single contact. With multipliers y of A x = b the Lagrangian therefore separates,
//
//     D(y) = -b . y + sum_i min_{x_i} [ 1/2 x_i' w_i x_i + (q_i + A_i' y) . x_i ],   u_i in F_i U,  lo <= F_i <= hi,
//
// and the dual is concave in m unknowns. Each inner problem has a closed form: with slopes s = q + A' y, a tangential
// component (or a round pair or triple of them) is u = -s_t / w clipped to F r, so F solves
//
//     w_n F + s_n - sum_t r max(0, |s_t| - w r F) = 0,   clipped to [lo, hi],
//
// whose left side increases and is the minimum of several straight lines, one for each set of saturated components: F
// is the largest of their roots. To a regular polygon of more edges its facet nearest to -s_t is one side of a
// rectangle, half as wide as the facet, as far as forces that are nearest to -s_t are concerned: seen along this facet
// and across it, both components are limited by themselves, as those of four edges are. The gradient of D is A x(y) -
// b. A generalised Hessian follows by differentiating x(y): per contact (v v') / slope along the edge or ray v on which
// a saturated force moves, 1 / w for components that are not saturated, and F / |s_t| (I - c c') around a cone (Qi and
// Sun 1993; the same idea as in SSNAL, Li, Sun and Toh 2018). The cost of a step grows linearly with the number of
// contacts. The line search is exact, since the directional derivative is monotone. Where it stays positive along a
// step, that step is tested as a Farkas certificate: the limit of the derivative is the margin of the certificate.
#pragma once

#include "algebra.hpp"
#include "lanes.hpp"
#include "problem.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// A regular polygon in the unit circle: half the directions of its facets, the others opposite (count, 2), their
// distance from the middle, and half their length.
struct Polygon {
    const double* directions;
    int count;
    double sizes[2];
};

template <bool fine>
struct Turned {};
template <>
struct Turned<true> {
    const Polygon* polygon;
    Vector across[2];  // direction of the facet that is nearest, where x was computed
};

// `width` contacts of one problem, or one contact of `width` problems.
template <class K>
struct Block : Turned<K::fine> {
    Vector a[K::D][K::M];                      // columns of the balance
    Vector w[K::D], q[K::D];                   // the objective 1/2 w x^2 + q x
    Vector lo, hi;                             // of F_n
    Vector x[K::D];                            // forces
    Vector s[K::D], v[K::D];                   // slopes, and their change along a step
    Vector norm;                               // of the round part of the slopes, where x was computed
    Vector inverse_w[K::D], inverse[K::sets];  // 1 / w; 1 / (w_n + what each set of saturated groups adds)

    // Weights of the groups, as they count for F_n.
    PINOGRASP_INLINE Vector weight(int g) const {
        constexpr int cones = K::R > 0 ? 1 : 0;
        if (g < cones) return w[0];
        const int j = g - cones + K::R;
        return Vector(radius(j) * radius(j)) * w[j];
    }

    // What component j, outside of the cone, is limited by, over F_n.
    PINOGRASP_INLINE double radius(int j) const {
        if constexpr (K::fine)
            if (j < 2) return this->polygon->sizes[j];
        return K::radius(j);
    }

    // Of the facets the one that components c point to most, or away from.
    PINOGRASP_INLINE void nearest_facet(const Vector* c, Vector* facet) const {
        const Polygon& own = *this->polygon;
        Vector most = -1.0;
        for (int a = 0; a < own.count; ++a) {
            const Vector x = own.directions[2 * a], y = own.directions[2 * a + 1], along = abs(x * c[0] + y * c[1]);
            const auto more = along > most;
            most = select(more, along, most);
            facet[0] = select(more, x, facet[0]);
            facet[1] = select(more, y, facet[1]);
        }
    }

    // Components across a facet and along it.
    static PINOGRASP_INLINE void turn(const Vector* facet, Vector* c) {
        const Vector x = c[0];
        c[0] = facet[0] * x + facet[1] * c[1];
        c[1] = facet[0] * c[1] - facet[1] * x;
    }

    // After a change of w.
    PINOGRASP_INLINE void weigh() {
        for (int j = 0; j < K::D; ++j) inverse_w[j] = Vector(1.0) / w[j];
        for (int set = 0; set < K::sets; ++set) {
            Vector total = w[K::E];
            for (int g = 0; g < K::groups; ++g)
                if (set >> g & 1) total = total + weight(g);
            inverse[set] = Vector(1.0) / total;
        }
    }

    // A contact that does not count.
    PINOGRASP_INLINE void blank() {
        for (int j = 0; j < K::D; ++j) {
            for (int r = 0; r < K::M; ++r) a[j][r] = 0.0;
            w[j] = 1.0;
            q[j] = x[j] = s[j] = v[j] = 0.0;
        }
        lo = hi = norm = 0.0;
        if constexpr (K::fine) this->across[0] = this->across[1] = 0.0;
    }

    // Length of the components that a cone bounds.
    static PINOGRASP_INLINE Vector round_length(const Vector* c) {
        Vector square = c[0] * c[0] + c[1] * c[1];
        if constexpr (K::R == 3) square = square + c[2] * c[2];
        return sqrt(square);
    }

    // How the groups pull at F_n, at slopes c, those of a fine pyramid seen from its facet.
    PINOGRASP_INLINE void pulls(const Vector* c, Vector* out) const {
        int g = 0;
        if constexpr (K::R > 0) out[g++] = round_length(c);
        for (int j = K::R; j < K::E; ++j) out[g++] = Vector(radius(j)) * abs(c[j]);
    }

    // x, the minimiser at slopes s + t v.
    PINOGRASP_INLINE void forces_at(Vector t) {
        Vector c[K::D], pull[K::groups];
        for (int j = 0; j < K::D; ++j) c[j] = s[j] + t * v[j];
        if constexpr (K::fine) {
            nearest_facet(c, this->across);
            turn(this->across, c);
        }
        pulls(c, pull);
        Vector F = lo;
        for (int set = 0; set < K::sets; ++set) {
            Vector total = -c[K::E];
            for (int g = 0; g < K::groups; ++g)
                if (set >> g & 1) total = total + pull[g];
            F = max(F, total * inverse[set]);
        }
        F = min(F, hi);
        x[K::E] = F;
        if constexpr (K::R > 0) {
            norm = pull[0];
            const Vector shrink = -F / max(max(pull[0], w[0] * F), Vector(1e-300));
            for (int j = 0; j < K::R; ++j) x[j] = shrink * c[j];
        }
        for (int j = K::R; j < K::E; ++j) {
            const Vector most = Vector(radius(j)) * F;
            x[j] = clamp(-c[j] * inverse_w[j], -most, most);
        }
        if constexpr (K::fine) {
            const Vector back[2] = {this->across[0], -this->across[1]};
            turn(back, x);
        }
    }

    // Adds to H, the upper triangle of an (N, N) matrix, the contact's part of a generalised Hessian of the negative
    // dual, for columns a of N rows: those of the balance, or others.
    template <int N>
    PINOGRASP_INLINE void add_hessian(const Vector (&a)[K::D][N], Vector* H) const {
        const Vector F = x[K::E];
        Vector slope = w[K::E], ray[N];
        for (int r = 0; r < N; ++r) ray[r] = a[K::E][r];
        if constexpr (K::R > 0) {
            const auto slips = norm > w[0] * F;
            slope = slope + select(slips, w[0], Vector(0.0));
            add_cone(a, H, slips, select(slips, F / norm, inverse_w[0]), ray);
        }
        const auto add_side = [&](int j, Vector own, const Vector* column) {
            const Vector r_j = radius(j);
            const auto slips = abs(own) > w[j] * r_j * F;
            const Vector edge = select(slips, select(own > Vector(0.0), r_j, -r_j), Vector(0.0));
            slope = slope + edge * edge * w[j];
            for (int r = 0; r < N; ++r) ray[r] = ray[r] - edge * column[r];
            add_square<N>(H, select(slips, Vector(0.0), inverse_w[j]), column);
        };
        if constexpr (K::fine) {
            Vector seen[2] = {s[0], s[1]}, columns[2][N];
            turn(this->across, seen);
            for (int r = 0; r < N; ++r) {
                Vector both[2] = {a[0][r], a[1][r]};
                turn(this->across, both);
                columns[0][r] = both[0];
                columns[1][r] = both[1];
            }
            for (int j = 0; j < 2; ++j) add_side(j, seen[j], columns[j]);
        }
        for (int j = K::fine ? 2 : K::R; j < K::E; ++j) add_side(j, s[j], a[j]);
        add_square<N>(H, select((lo < F) & (F < hi), Vector(1.0) / slope, Vector(0.0)), ray);
    }

    // The directions of a cone that are free of F_n, with weight `around`; where it slips, the ray leaves the axis.
    template <int N>
    PINOGRASP_INLINE void add_cone(const Vector (&a)[K::D][N], Vector* H, decltype(Vector() > Vector()) slips,
                                   Vector around, Vector* ray) const {
        const auto none = norm == Vector(0.0);
        const Vector inverse_norm = select(none, Vector(0.0), Vector(1.0) / norm);
        const Vector u = select(none, Vector(1.0), s[0] * inverse_norm), v1 = s[1] * inverse_norm;
        Vector radial[N];
        if constexpr (K::R == 2) {
            Vector across[N];
            for (int r = 0; r < N; ++r) {
                radial[r] = a[0][r] * u + a[1][r] * v1;
                across[r] = a[1][r] * u - a[0][r] * v1;
            }
            add_square<N>(H, around, across);
            add_square<N>(H, select(slips, Vector(0.0), around), radial);
        } else {
            const Vector z = s[2] * inverse_norm;
            for (int r = 0; r < N; ++r) radial[r] = a[0][r] * u + a[1][r] * v1 + a[2][r] * z;
            for (int j = 0; j < 3; ++j) add_square<N>(H, around, a[j]);
            add_square<N>(H, select(slips, -around, Vector(0.0)), radial);
        }
        for (int r = 0; r < N; ++r) ray[r] = ray[r] - select(slips, radial[r], Vector(0.0));
    }

    template <int N>
    static PINOGRASP_INLINE void add_square(Vector* H, Vector weight, const Vector* direction) {
        PINOGRASP_UNROLL
        for (int r = 0; r < N; ++r) {
            const Vector t = weight * direction[r];
            PINOGRASP_UNROLL
            for (int c = r; c < N; ++c) H[upper<N>(r, c)] = H[upper<N>(r, c)] + t * direction[c];
        }
    }

    // A' y for multipliers of all lanes.
    template <class S>
    PINOGRASP_INLINE void columns_along(const S* y, Vector* out) const {
        for (int j = 0; j < K::D; ++j) {
            out[j] = a[j][0] * Vector(y[0]);
            PINOGRASP_UNROLL
            for (int r = 1; r < K::M; ++r) out[j] = out[j] + a[j][r] * Vector(y[r]);
        }
    }

    // The least c . x of all admissible x.
    PINOGRASP_INLINE Vector least(const Vector* c) const {
        Vector seen[K::D], pull[K::groups], total = c[K::E];
        for (int j = 0; j < K::D; ++j) seen[j] = c[j];
        if constexpr (K::fine) {
            Vector facet[2] = {0.0, 0.0};
            nearest_facet(seen, facet);
            turn(facet, seen);
        }
        pulls(seen, pull);
        for (int g = 0; g < K::groups; ++g) total = total - pull[g];
        return min(lo * total, hi * total);
    }
};

// How far A x is from b, and the largest violation of friction and bounds on F_n.
template <class S>
struct Misses {
    S balance, violation;
};

template <class S, class K>
Misses<S> judge(const Block<K>* blocks, int count, const S* b) {
    Vector total[K::M], worst = -infinity;
    for (Vector& one : total) one = 0.0;
    for (int i = 0; i < count; ++i) {
        const Block<K>& at = blocks[i];
        const Vector F = at.x[K::E];
        Vector used = max(at.lo - F, F - at.hi);
        if constexpr (K::R > 0) used = max(used, at.round_length(at.x) - F);
        Vector seen[K::E];
        for (int j = 0; j < K::E; ++j) seen[j] = at.x[j];
        if constexpr (K::fine) {
            Vector facet[2] = {0.0, 0.0};
            at.nearest_facet(seen, facet);
            at.turn(facet, seen);
        }
        // A corner is nearer to no other facet.
        for (int j = K::R; j < K::E; ++j) used = max(used, abs(seen[j]) * Vector(1.0 / at.radius(j)) - F);
        worst = max(worst, used);
        for (int r = 0; r < K::M; ++r)
            for (int j = 0; j < K::D; ++j) total[r] = total[r] + at.a[j][r] * at.x[j];
    }
    S square = 0.0;
    for (int r = 0; r < K::M; ++r) {
        const S off = sum_to<S>(total[r]) - b[r];
        square = square + off * off;
    }
    return {sqrt(square), largest_to<S>(worst)};
}

// The dual of one problem (S = double) or of one in each lane (S = Vector).
template <class K, class S>
class Dual {
public:
    using Truth = decltype(S() > S());
    static constexpr int patience = 8;  // steps before y is first tested as a ray
    struct Step {
        Truth infeasible, stalled;
    };

    Block<K>* blocks = nullptr;
    int count = 0;       // of blocks
    S b[K::M], y[K::M];  // right-hand side of the balance, multipliers
    double give = 0.0;   // > 0: the balance may be missed at a cost of |A x - b|^2 / (2 give)

    // Slopes and forces at y, of these lanes: the others', which their steps have added up, differ by rounding.
    PINOGRASP_INLINE void begin(Truth which) {
        for (int i = 0; i < count; ++i) {
            Block<K>& at = blocks[i];
            Vector s[K::D], x[K::D], norm = at.norm;
            at.columns_along(y, s);
            for (int j = 0; j < K::D; ++j) {
                at.s[j] = select(which, s[j] + at.q[j], at.s[j]);
                at.v[j] = select(which, Vector(0.0), at.v[j]);  // of the last problem, it could be no number
                x[j] = at.x[j];
            }
            at.forces_at(Vector(0.0));
            for (int j = 0; j < K::D; ++j) at.x[j] = select(which, at.x[j], x[j]);
            at.norm = select(which, at.norm, norm);
        }
    }

    // A x - b - give y, for the next step; returns its largest entry.
    PINOGRASP_INLINE S residual() {
        Vector total[K::M];
        for (int r = 0; r < K::M; ++r) total[r] = 0.0;
        for (int i = 0; i < count; ++i)
            for (int r = 0; r < K::M; ++r)
                for (int j = 0; j < K::D; ++j) total[r] = total[r] + blocks[i].a[j][r] * blocks[i].x[j];
        S size = 0.0;
        for (int r = 0; r < K::M; ++r) {
            residual_[r] = sum_to<S>(total[r]) - b[r] - S(give) * y[r];
            size = max(size, abs(residual_[r]));
        }
        largest_ = size;
        return size;
    }

    // One Newton step of the active lanes. Infeasible: y became a ray along which the dual grows without bound, the
    // largest entry 1. ``doubtful``: is y itself such a ray?
    PINOGRASP_INLINE Step step(Truth active, Truth doubtful) {
        direct();
        S start = 0.0;
        for (int r = 0; r < K::M; ++r) start = start + residual_[r] * step_[r];
        Step found{Truth(active & !active), Truth(active & !(start > S(0.0)))};
        active = Truth(active & !found.stalled);
        if (give == 0.0 && any(doubtful & active)) {
            const Truth rays = doubtful & active & proves(y);
            normalise(rays, y);
            found.infeasible = rays;
            active = active & !rays;
        }
        for (int i = 0; i < count; ++i) blocks[i].columns_along(step_, blocks[i].v);
        const S t = search(active, start, found);
        active = active & !(found.infeasible | found.stalled);
        const S taken = select(active, t, S(0.0));
        for (int r = 0; r < K::M; ++r) y[r] = y[r] + taken * step_[r];
        for (int i = 0; i < count; ++i)
            for (int j = 0; j < K::D; ++j) blocks[i].s[j] = blocks[i].s[j] + Vector(taken) * blocks[i].v[j];
        return found;
    }

    // The least y . (A x - b) of all admissible x.
    PINOGRASP_INLINE S least_along(const S* ray) const {
        Vector total = 0.0;
        for (int i = 0; i < count; ++i) {
            Vector c[K::D];
            slopes(i, ray, c);
            total = total + blocks[i].least(c);
        }
        return sum_to<S>(total) - limits_along(ray);
    }

    // What multipliers make of the right-hand sides, and of the slopes of block i.
    PINOGRASP_INLINE S limits_along(const S* ray) const {
        S found = 0.0;
        for (int r = 0; r < K::M; ++r) found = found + b[r] * ray[r];
        return found;
    }
    PINOGRASP_INLINE void slopes(int i, const S* ray, Vector* out) const { blocks[i].columns_along(ray, out); }

    S missed() const { return judge(blocks, count, b).balance; }
    static constexpr int rows() { return K::M; }

private:
    static constexpr int searches = 40;  // evaluations of one line search
    S residual_[K::M], step_[K::M], largest_;

    // The step: (Hessian + give + a small regularisation) step = residual.
    PINOGRASP_INLINE void direct() {
        Vector sums[triangle<K::M>];
        for (Vector& one : sums) one = 0.0;
        for (int i = 0; i < count; ++i) blocks[i].add_hessian(blocks[i].a, sums);
        S H[triangle<K::M>], trace = 0.0;
        for (int i = 0; i < triangle<K::M>; ++i) H[i] = sum_to<S>(sums[i]);
        for (int r = 0; r < K::M; ++r) trace = trace + H[upper<K::M>(r, r)];
        // Where every contact is at its limits the dual is linear: this keeps the matrix regular.
        const S lift = S(give + 1e-12) + S(1e-14) * trace + min(S(1e-2), S(1e-3) * largest_);
        for (int r = 0; r < K::M; ++r) {
            H[upper<K::M>(r, r)] = H[upper<K::M>(r, r)] + lift;
            step_[r] = residual_[r];
        }
        factor<K::M>(H);
        solve<K::M>(H, step_);
    }

    // Whether a ray is a Farkas certificate: ray . (A x - b) > 0 for all admissible x.
    PINOGRASP_INLINE Truth proves(const S* ray) const {
        S size = 0.0;
        for (int r = 0; r < K::M; ++r) size = max(size, abs(ray[r]));
        return least_along(ray) > S(proven) * size;
    }

    // Where `which`, y becomes the ray, its largest entry 1.
    PINOGRASP_INLINE void normalise(Truth which, const S* ray) {
        S size = 1e-300;
        for (int r = 0; r < K::M; ++r) size = max(size, abs(ray[r]));
        for (int r = 0; r < K::M; ++r) y[r] = select(which, ray[r] / size, y[r]);
    }

    // The derivative of the dual at y + t step, whose part without forces is -fixed - t pull; the forces there are x.
    PINOGRASP_INLINE S derivative_at(S t, S fixed, S pull) {
        Vector total = 0.0;
        for (int i = 0; i < count; ++i) {
            Block<K>& at = blocks[i];
            at.forces_at(Vector(t));
            for (int j = 0; j < K::D; ++j) total = total + at.v[j] * at.x[j];
        }
        return sum_to<S>(total) - fixed - t * pull;
    }

    // How far to go along the step, with the forces there. The derivative falls from `start`: its root by regula falsi
    // (Illinois).
    PINOGRASP_INLINE S search(Truth active, S start, Step& found) {
        S fixed = 0.0, pull = 0.0;
        for (int r = 0; r < K::M; ++r) {
            fixed = fixed + (b[r] + S(give) * y[r]) * step_[r];
            pull = pull + S(give) * step_[r] * step_[r];
        }
        S below = 0.0, above = -1.0, at_below = start, at_above = 0.0, side = 0.0, t = select(active, S(1.0), S(0.0));
        for (int round = 0; round < searches; ++round) {
            const S along = derivative_at(t, fixed, pull);
            active = active & (abs(along) > S(0.3) * start);
            if (!any(active) || round == searches - 1) break;
            const Truth past = along<S(0.0), again = select(past, -side, side)> S(0.0);
            at_below = select(past, select(again, S(0.5) * at_below, at_below), along);
            at_above = select(past, along, select(again, S(0.5) * at_above, at_above));
            above = select(past, t, above);
            below = select(past, below, t);
            side = select(past, S(-1.0), S(1.0));
            const Truth open = above < S(0.0);
            if (round == 1 && give == 0.0 && any(active & open)) {
                // The derivative is still positive: does it stay so?
                const Truth rays = active & open & proves(step_);
                normalise(rays, step_);
                found.infeasible = found.infeasible | rays;
                active = active & !rays;
            }
            const S next = select(open, S(4.0) * t, below + at_below * (above - below) / (at_below - at_above));
            t = select(active, next, t);
            const Truth far = active & (t > S(1e14));
            found.stalled = found.stalled | far;
            active = active & !far;
        }
        return t;
    }
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
