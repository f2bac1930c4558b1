// A force problem, dimensionless: k contacts with d components each, the normal force F_n the last of them.
//
//     minimise  1/2 x'Px + q'x + sum phi(F_n) + peak max F_n
//     subject to  A x = b,  R_lo <= R x <= R_hi,  friction,  lo <= F_n <= hi
//
// Arrays are by component: component j of contact i is entry j k + i, so that contacts are neighbours in memory.
#pragma once

#include "lanes.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

enum class Code : int { converged = 0, stalled = 1, infeasible = 2 };

constexpr double proven = 1e-9;  // margin of a Farkas certificate, relative to the load
constexpr double infinity = __builtin_huge_val();
constexpr int most_powers = 8;
constexpr int most_contacts = 1 << 24;  // also of joints and rows: sizes of arrays do not overflow

// The friction cone F_n U: the first `round` tangential components (0, 2 or 3) together up to F_n, the others each up
// to its radius times F_n; or, for polyhedral cones of many edges, facets F_n >= C u.
struct Friction {
    int d = 3;
    int round = 2;
    double radii[3] = {1.0, 1.0, 1.0};
    int facets = 0;
    const double* C = nullptr;         // (facets, d - 1)
    int corners = 0;                   // of a polygon, where `round` is 0
    const double* vertices = nullptr;  // (corners, 2)
};

// phi' is the sum of coefficients[a] F^exponents[a], with exponents >= 0.
struct Powers {
    int count = 0;
    double coefficients[most_powers] = {};
    double exponents[most_powers] = {};
};

struct Problem {
    int k = 0, m = 0, r = 0;  // contacts, rows of the balance, torque rows
    Friction friction;
    const double* B = nullptr;                      // balance, then torque rows (m + r, d k)
    const double* b = nullptr;                      // (m)
    const double *lo = nullptr, *hi = nullptr;      // lo < hi (k)
    const double *R_lo = nullptr, *R_hi = nullptr;  // R_lo < R_hi (r)
    const double* P = nullptr;                      // blocks of the contacts, symmetric (d, d, k)
    const double* q = nullptr;                      // (d k)
    Powers powers;
    double peak = 0.0;
};

// D components of a force, the first R of them in a cone; M rows of the balance. Fine: the first two are in a regular
// polygon of more than four corners.
template <int D_, int R_, bool Fine = false>
struct Shape {
    static constexpr bool fine = Fine;
    static constexpr int D = D_, R = R_, M = 6, E = D_ - 1;
    static constexpr int groups = (R_ > 0 ? 1 : 0) + E - R_;  // of components that saturate together
    static constexpr int sets = 1 << groups;
    // What component j, outside of the cone, is limited by, over F_n. A pyramid's four edges lie on the cone.
    static constexpr double radius(int j) { return R_ == 0 && j < 2 ? 0.70710678118654752 : 1.0; }
};

// Whether there is a shape for forces of d components, the first `round` of them in a cone.
constexpr bool has_shape(int d, int round) {
    return round == 0 || round == 2 ? d == 3 || d == 4 : round == 3 && d == 4;
}

// f of the shape for these sizes, which `has_shape`.
template <class F>
auto of_shape(int d, int round, const F& f) {
    switch (10 * d + round) {
        case 30:
            return f(Shape<3, 0>{});
        case 32:
            return f(Shape<3, 2>{});
        case 40:
            return f(Shape<4, 0>{});
        case 42:
            return f(Shape<4, 2>{});
        default:
            return f(Shape<4, 3>{});
    }
}

// The same; `edges`: of the polygon, where there is no cone.
template <class F>
auto of_shape(int d, int round, int edges, const F& f) {
    if (round > 0 || edges <= 4) return of_shape(d, round, f);
    return d == 3 ? f(Shape<3, 0, true>{}) : f(Shape<4, 0, true>{});
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
