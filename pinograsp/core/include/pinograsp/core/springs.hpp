// Contacts of many grasps that give way as equally stiff springs: how they react to wrenches that are added to the
// load, and what such reactions ask of the forces. Lanes are wrenches, whose number m is a multiple of the width; the
// surplus ones are zero.
#pragma once

#include "columns.hpp"
#include "memory.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// Contacts of N grasps, up to k each, of which the first `counts` (N) count; d components each, the normal last.
struct Springs {
    int k = 0, d = 0, m = 0;
    double torsion = 0.0;               // [m], the unit of the component that turns
    const double* points = nullptr;     // about the centres of mass (N, k, 3)
    const double* rotations = nullptr;  // contact frames (N, k, 3, 3)
    const std::int64_t* counts = nullptr;
    const double* arms = nullptr;      // moments count as forces at this distance (N)
    const double* wrenches = nullptr;  // (6, m)
};

// Their changes of force (G, k, d, m), and whether they can balance the wrenches at all (G, m); of n grasps `rows`.
struct Reactions {
    int k = 0, d = 0, m = 0;
    double* change = nullptr;
    bool* borne = nullptr;
    const std::int64_t* counts = nullptr;  // (G)
    const std::int64_t* rows = nullptr;    // (n)
};

// What friction allows per newton of F_n: components over `limits` (d - 1), the first `round` in a ball, all of them
// within the facets' rows (facets, d - 1).
struct Limits {
    int round = 0, facets = 0;
    const double *limits = nullptr, *rows = nullptr;
};

// The eigenvalues of symmetric matrices A, their upper triangles, left on the diagonal, and their eigenvectors, columns
// of V: Jacobi's rotations, in each lane as many as it needs.
inline void diagonalise(Vector (&A)[6][6], Vector (&V)[6][6]) {
    constexpr int M = 6, most_sweeps = 16;
    for (int r = 0; r < M; ++r)
        for (int c = 0; c < M; ++c) V[r][c] = r == c ? 1.0 : 0.0;
    for (int sweep = 0; sweep < most_sweeps; ++sweep) {
        Vector off = 0.0, all = 1e-300;
        for (int r = 0; r < M; ++r) {
            all = all + A[r][r] * A[r][r];
            for (int c = r + 1; c < M; ++c) off = off + A[r][c] * A[r][c];
        }
        const auto open = off > Vector(1e-34) * all;
        if (!any(open)) return;
        for (int p = 0; p < M; ++p)
            for (int q = p + 1; q < M; ++q) {
                const Vector own = A[p][q];
                const auto turns = open & (abs(own) > Vector(1e-150));
                const Vector theta = Vector(0.5) * (A[q][q] - A[p][p]) / select(turns, own, Vector(1.0));
                const Vector size = Vector(1.0) / (abs(theta) + sqrt(theta * theta + Vector(1.0)));
                const Vector t = select(turns, select(theta < Vector(0.0), -size, size), Vector(0.0));
                const Vector cosine = Vector(1.0) / sqrt(t * t + Vector(1.0)), sine = t * cosine;
                A[p][p] = A[p][p] - t * own;
                A[q][q] = A[q][q] + t * own;
                A[p][q] = select(turns, Vector(0.0), own);
                const auto turn = [&](Vector& one, Vector& other) {
                    const Vector before = one;
                    one = cosine * before - sine * other;
                    other = sine * before + cosine * other;
                };
                for (int r = 0; r < M; ++r) {
                    if (r != p && r != q) turn(r < p ? A[r][p] : A[p][r], r < q ? A[r][q] : A[q][r]);
                    turn(V[r][p], V[r][q]);
                }
            }
    }
}

// How contacts react; `width` grasps at once, as far as their matrices are concerned.
class SpringBalance {
public:
    SpringBalance(const Springs& springs, const Reactions& into) : own_(springs), into_(into) {
        columns_ = memory_.part<double>(std::size_t(width) * own_.k * own_.d * 6);
        weights_ = memory_.part<double>(own_.k);
    }

    // Grasps `start` to `stop`, all springs alike.
    void alike(std::int64_t start, std::int64_t stop) {
        groups(start, stop, nullptr, own_.d, [&](std::int64_t p, int lane) { balance(p, lane, own_.d, nullptr); });
    }

    // The same normal forces, those of `whole`; tangential ones of least sum of squares, each over its capacity (N, k).
    void spread(std::int64_t start, std::int64_t stop, const Reactions& whole, const double* capacities) {
        groups(start, stop, capacities, own_.d - 1,
               [&](std::int64_t p, int lane) { balance(p, lane, own_.d - 1, &whole); });
    }

private:
    static constexpr double rank = 1e-12;    // of eigenvalues: smaller shares of the largest count as zero
    static constexpr double reached = 1e-6;  // share of a wrench that springs may leave unbalanced

    Springs own_;
    Reactions into_;
    Memory memory_;
    double *columns_, *weights_;
    Vector values_[6][6], vectors_[6][6];
    const double* capacities_ = nullptr;

    // Columns of contact i of the grasp in a lane (d, 6).
    double* columns(int lane, int i) const { return columns_ + (std::size_t(lane) * own_.k + i) * own_.d * 6; }

    template <class F>
    void groups(std::int64_t start, std::int64_t stop, const double* capacities, int used, const F& each) {
        capacities_ = capacities;
        for (std::int64_t first = start; first < stop; first += width) {
            const int some = static_cast<int>(stop - first < width ? stop - first : width);
            for (int lane = 0; lane < width; ++lane) place(first + lane, lane, lane < some, used);
            diagonalise(values_, vectors_);
            for (int lane = 0; lane < some; ++lane) each(first + lane, lane);
        }
    }

    // The weights of a grasp's tangential components.
    void weigh(std::int64_t p) {
        const int count = static_cast<int>(own_.counts[p]);
        double most = 1e-12;
        for (int i = 0; i < own_.k && capacities_; ++i) most = max(most, capacities_[p * own_.k + i]);
        for (int i = 0; i < count; ++i) weights_[i] = capacities_ ? max(capacities_[p * own_.k + i], 1e-3 * most) : 1.0;
    }

    // The columns of a grasp, and the matrix of the used ones: in a lane.
    void place(std::int64_t p, int lane, bool there, int used) {
        const int count = there ? static_cast<int>(own_.counts[p]) : 0;
        double sums[6][6] = {};
        if (there) weigh(p);
        for (int i = 0; i < count; ++i) {
            const std::int64_t at = p * own_.k + i;
            double* own = columns(lane, i);
            spring_columns(own_.points + 3 * at, own_.rotations + 9 * at, own_.arms[p], own);
            for (int j = 0; j < used; ++j) {
                const double square = weights_[i] * weights_[i];
                for (int r = 0; r < 6; ++r)
                    for (int c = r; c < 6; ++c) sums[r][c] += square * own[6 * j + r] * own[6 * j + c];
            }
        }
        for (int r = 0; r < 6; ++r)
            for (int c = r; c < 6; ++c) in_lane(values_[r][c], lane) = sums[r][c];
    }

    void spring_columns(const double* point, const double* R, double arm, double* out) const {
        for (int c = 0; c < 3; ++c) {
            double* own = out + 6 * (c == 2 ? own_.d - 1 : c);
            wrench_of(point, R[c], R[3 + c], R[6 + c], arm, own);
        }
        for (int r = 0; r < 6 && own_.d == 4; ++r) out[12 + r] = r < 3 ? 0.0 : R[3 * (r - 3) + 2] * own_.torsion / arm;
    }

    // The reactions of a grasp in a lane; `whole`: whose normal forces are the same.
    void balance(std::int64_t p, int lane, int used, const Reactions* whole) {
        const int count = static_cast<int>(own_.counts[p]), d = own_.d, m = own_.m;
        double V[6][6], inverse[6], most = 1e-300;
        for (int a = 0; a < 6; ++a) most = max(most, in_lane(values_[a][a], lane));
        for (int a = 0; a < 6; ++a) {
            const double value = in_lane(values_[a][a], lane);
            inverse[a] = value > rank * most ? 1.0 / value : 0.0;
            for (int r = 0; r < 6; ++r) V[r][a] = in_lane(vectors_[r][a], lane);
        }
        weigh(p);
        double* change = into_.change + p * own_.k * d * m;
        for (int at = 0; at < m; at += width) {
            Vector w[6], along[6], z[6], total = 0.0, rest = 0.0;
            for (int r = 0; r < 6; ++r)
                w[r] = lanes_at(own_.wrenches + r * m + at) * Vector(r < 3 ? 1.0 : 1.0 / own_.arms[p]);
            for (int i = 0; i < count && whole; ++i) {
                const double* normal = whole->change + ((p * own_.k + i) * d + d - 1) * m + at;
                const double* column = columns(lane, i) + 6 * (d - 1);
                const Vector F = lanes_at(normal);
                for (int r = 0; r < 6; ++r) w[r] = w[r] + Vector(column[r]) * F;
                store(F, change + (i * d + d - 1) * m + at);
            }
            for (int a = 0; a < 6; ++a) {
                along[a] = 0.0;
                for (int r = 0; r < 6; ++r) along[a] = along[a] + Vector(V[r][a]) * w[r];
                total = total + along[a] * along[a];
                if (inverse[a] == 0.0) rest = rest + along[a] * along[a];
                along[a] = along[a] * Vector(-inverse[a]);
            }
            for (int r = 0; r < 6; ++r) {
                z[r] = 0.0;
                for (int a = 0; a < 6; ++a) z[r] = z[r] + Vector(V[r][a]) * along[a];
            }
            const Mask borne = sqrt(rest) <= Vector(reached) * max(sqrt(total), Vector(1e-300));
            for (int l = 0; l < width; ++l)
                into_.borne[p * m + at + l] = lane_of(borne, l) && (!whole || whole->borne[p * m + at + l]);
            for (int i = 0; i < count; ++i)
                for (int j = 0; j < used; ++j) {
                    const double* column = columns(lane, i) + 6 * j;
                    Vector found = 0.0;
                    for (int r = 0; r < 6; ++r) found = found + Vector(column[r]) * z[r];
                    const double unit = (d == 4 && j == 2 ? own_.torsion : 1.0) * weights_[i] * weights_[i];
                    store(found * Vector(unit), change + (i * d + j) * m + at);
                }
        }
    }
};

// What friction makes of components over their limits.
PINOGRASP_INLINE Vector gauge(const Limits& limits, int size, const Vector* u) {
    Vector found = -infinity;
    if (limits.round > 0) {
        Vector square = u[0] * u[0] + u[1] * u[1];
        if (limits.round == 3) square = square + u[2] * u[2];
        found = sqrt(square);
    }
    for (int f = 0; f < limits.facets; ++f) {
        Vector along = 0.0;
        for (int j = 0; j < size; ++j) along = along + Vector(limits.rows[f * size + j]) * u[j];
        found = max(found, along);
    }
    return found;
}

// By how much F_n is to exceed what friction needs, so that `shares` (n) of the wrenches are borne: offsets (n, k).
// With forces `local` (n, k, d) exactly, without for any.
inline void find_offsets(const Reactions& own, const Limits& limits, std::int64_t start, std::int64_t stop,
                         const double* local, const double* shares, double* offsets) {
    const int d = own.d, size = d - 1;
    for (std::int64_t p = start; p < stop; ++p) {
        const std::int64_t g = own.rows[p];
        for (int i = 0; i < own.counts[g]; ++i) {
            const double *change = own.change + (g * own.k + i) * d * own.m,
                         *force = local ? local + (p * own.k + i) * d : nullptr;
            Vector before[3], u[3], most = 0.0;
            for (int j = 0; j < size; ++j) before[j] = force ? force[j] / limits.limits[j] : 0.0;
            for (int at = 0; at < own.m; at += width) {
                for (int j = 0; j < size; ++j)
                    u[j] = before[j] + lanes_at(change + j * own.m + at) * Vector(shares[p] / limits.limits[j]);
                most = max(most, gauge(limits, size, u) - Vector(shares[p]) * lanes_at(change + size * own.m + at));
            }
            offsets[p * own.k + i] = max(largest(most - (force ? gauge(limits, size, before) : Vector(0.0))), 0.0);
        }
    }
}

// The least s > 0 that takes forces f + s df to the edge of friction; infinity where there is none.
PINOGRASP_INLINE Vector edge_of(const Limits& limits, int size, const Vector* t, const Vector* dt, Vector F,
                                Vector dF) {
    const Vector none = infinity, tiny = 1e-300;
    Vector least = none;
    if (limits.round > 0) {
        Vector a = -dF * dF, b = -F * dF, c = -F * F;
        for (int j = 0; j < limits.round; ++j) {
            a = a + dt[j] * dt[j];
            b = b + t[j] * dt[j];
            c = c + t[j] * t[j];
        }
        c = min(c, Vector(0.0));
        const Vector inner = b * b - a * c, slope = b + sqrt(max(inner, Vector(0.0)));
        least = select((inner >= Vector(0.0)) & (slope > Vector(0.0)), -c / max(slope, tiny), none);
    }
    for (int f = 0; f < limits.facets; ++f) {
        Vector room = F, rate = -dF;
        for (int j = 0; j < size; ++j) {
            const Vector row = limits.rows[f * size + j];
            room = room - row * t[j];
            rate = rate + row * dt[j];
        }
        least = min(least, select(rate > Vector(0.0), max(room, Vector(0.0)) / max(rate, tiny), none));
    }
    return least;
}

// Multiples (n, m) of each wrench that forces (n, k, d) withstand before the first contact slips or opens.
inline void find_multiples(const Reactions& own, const Limits& limits, std::int64_t start, std::int64_t stop,
                           const double* local, double* multiples) {
    const int d = own.d, size = d - 1;
    for (std::int64_t p = start; p < stop; ++p) {
        const std::int64_t g = own.rows[p];
        for (int at = 0; at < own.m; at += width) {
            Vector least = infinity;
            for (int i = 0; i < own.counts[g]; ++i) {
                const double *change = own.change + (g * own.k + i) * d * own.m + at,
                             *force = local + (p * own.k + i) * d;
                Vector t[3], dt[3];
                for (int j = 0; j < size; ++j) {
                    t[j] = force[j] / limits.limits[j];
                    dt[j] = lanes_at(change + j * own.m) * Vector(1.0 / limits.limits[j]);
                }
                least = min(least, edge_of(limits, size, t, dt, force[size], lanes_at(change + size * own.m)));
            }
            for (int l = 0; l < width; ++l)
                multiples[p * own.m + at + l] = own.borne[g * own.m + at + l] ? in_lane(least, l) : 0.0;
        }
    }
}

// Joint torques of contacts with Jacobians (J, k, 6, joints), of which the n grasps are `places` (n), and frames
// (n, k, 3, 3): `torques` (n, joints) of forces (n, k, d) and what is there without them, and the largest sizes
// (n, joints) that the reactions bring them to.
struct Efforts {
    int joints = 0;
    const std::int64_t* places = nullptr;
    const double *jacobians = nullptr, *rotations = nullptr, *bias = nullptr, *local = nullptr;
    double *torques = nullptr, *most = nullptr;
};

inline void find_efforts(const Reactions& own, std::int64_t start, std::int64_t stop, const Efforts& of) {
    const int d = own.d, n = of.joints, m = own.m;
    Memory memory;
    double* added = memory.part<double>(std::size_t(n) * m);
    for (std::int64_t p = start; p < stop; ++p) {
        const std::int64_t g = own.rows[p];
        double *tau = of.torques + p * n, *most = of.most + p * n;
        for (int j = 0; j < n; ++j) tau[j] = of.bias[p * n + j];
        for (int i = 0; i < n * m; ++i) added[i] = 0.0;
        for (int i = 0; i < own.counts[g]; ++i) {
            const std::int64_t at = p * own.k + i;
            const double *J = of.jacobians + (of.places[p] * own.k + i) * 6 * n, *R = of.rotations + at * 9;
            for (int c = 0; c < d; ++c) {
                const bool turns = d == 4 && c == 2;
                const double *along = R + (c == d - 1 ? 2
                                           : turns    ? 2
                                                      : c),
                             *rows = J + (turns ? 3 * n : 0), *change = own.change + ((g * own.k + i) * d + c) * m;
                for (int j = 0; j < n; ++j) {
                    const double column = rows[j] * along[0] + rows[n + j] * along[3] + rows[2 * n + j] * along[6];
                    if (column == 0.0) continue;
                    tau[j] += column * of.local[at * d + c];
                    double* sum = added + j * m;
                    for (int l = 0; l < m; l += width)
                        store(lanes_at(sum + l) + Vector(column) * lanes_at(change + l), sum + l);
                }
            }
        }
        for (int j = 0; j < n; ++j) {
            Vector size = std::fabs(tau[j]);
            for (int l = 0; l < m; l += width) size = max(size, abs(Vector(tau[j]) + lanes_at(added + j * m + l)));
            most[j] = largest(size);
        }
    }
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
