// Second-order cones of the interior-point method, `width` contacts at a time.
//
// Scaled by Nesterov and Todd's point (1997); formulas as in Vandenberghe (2010).
#pragma once

#include "contact_blocks.hpp"
#include "lanes.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// R components, and the head that bounds their length.
template <int R>
struct ConeVector {
    Vector v[R + 1];
};

// The product of all components but the heads.
template <int R>
PINOGRASP_INLINE Vector along(const ConeVector<R>& a, const ConeVector<R>& b) {
    Vector total = a.v[0] * b.v[0];
    for (int j = 1; j < R; ++j) total = total + a.v[j] * b.v[j];
    return total;
}

template <int R>
PINOGRASP_INLINE Vector product(const ConeVector<R>& a, const ConeVector<R>& b) {
    return along(a, b) + a.v[R] * b.v[R];
}

template <int R>
PINOGRASP_INLINE Vector determinant(const ConeVector<R>& a) {
    return a.v[R] * a.v[R] - along(a, a);
}

// a o b.
template <int R>
PINOGRASP_INLINE ConeVector<R> jordan(const ConeVector<R>& a, const ConeVector<R>& b) {
    ConeVector<R> found;
    for (int j = 0; j < R; ++j) found.v[j] = a.v[R] * b.v[j] + b.v[R] * a.v[j];
    found.v[R] = product(a, b);
    return found;
}

// The c with lambda o c = centre e - p.
template <int R>
PINOGRASP_INLINE ConeVector<R> jordan_quotient(const ConeVector<R>& lambda, const ConeVector<R>& p, Vector centre) {
    const Vector tiny = 1e-300;
    ConeVector<R> found;
    found.v[R] = (lambda.v[R] * (centre - p.v[R]) + along(lambda, p)) / max(determinant(lambda), tiny);
    for (int j = 0; j < R; ++j) found.v[j] = (-p.v[j] - found.v[R] * lambda.v[j]) / max(lambda.v[R], tiny);
    return found;
}

// The largest step up to `step` that keeps v + step dv in the cone.
template <int R>
PINOGRASP_INLINE Vector to_cone(const ConeVector<R>& v, const ConeVector<R>& dv, Vector step) {
    const Vector zero = 0.0;
    const Vector a = determinant(dv), b = v.v[R] * dv.v[R] - along(v, dv), c = determinant(v);
    const auto inside = (v.v[R] + step * dv.v[R] > zero) & (c + step * (b + b + step * a) > zero);
    // Least positive root of a t^2 + 2 b t + c, c > 0.
    const Vector square = b * b - a * c, root = sqrt(max(square, zero)) - b;
    const auto crosses = (square >= zero) & ((b < zero) | (a < zero)) & (root > zero);
    Vector most = min(step, select(crosses, c / root, step));
    most = min(most, select(dv.v[R] < zero, -v.v[R] / dv.v[R], most));
    return select(inside, step, most);
}

// Nesterov and Todd's scaling W of a vector s and its multiplier z, with W z = W^-1 s.
template <int R>
struct Scaling {
    ConeVector<R> bar;
    Vector size;

    Scaling() = default;
    PINOGRASP_INLINE Scaling(const ConeVector<R>& s, const ConeVector<R>& z) {
        const Vector ss = sqrt(max(determinant(s), Vector(1e-300))), zz = sqrt(max(determinant(z), Vector(1e-300)));
        const Vector half = Vector(0.5) / sqrt(Vector(0.5) * (Vector(1.0) + product(s, z) / (ss * zz)));
        const Vector a = half / ss, b = half / zz;
        for (int j = 0; j < R; ++j) bar.v[j] = a * s.v[j] - b * z.v[j];
        bar.v[R] = a * s.v[R] + b * z.v[R];
        size = sqrt(ss / zz);
    }

    // W v with the scale `size`.
    PINOGRASP_INLINE ConeVector<R> times(const ConeVector<R>& v, Vector scale) const { return turned(v, scale, 1.0); }

    // W^-1 v with the scale 1 / `size`.
    PINOGRASP_INLINE ConeVector<R> into(const ConeVector<R>& v, Vector scale) const { return turned(v, scale, -1.0); }

    // Adds W^-2 to the block of a contact with D components.
    template <int D>
    PINOGRASP_INLINE void add_hessian(Vector* h) const {
        constexpr auto at = upper<D>;
        const Vector scale = Vector(1.0) / (size * size), t = scale + scale;
        for (int a = 0; a < R; ++a) {
            for (int c = a; c < R; ++c) h[at(a, c)] = h[at(a, c)] + t * bar.v[a] * bar.v[c];
            h[at(a, a)] = h[at(a, a)] + scale;
            h[at(a, D - 1)] = h[at(a, D - 1)] - t * bar.v[a] * bar.v[R];
        }
        h[at(D - 1, D - 1)] = h[at(D - 1, D - 1)] + t * bar.v[R] * bar.v[R] - scale;
    }

private:
    PINOGRASP_INLINE ConeVector<R> turned(const ConeVector<R>& v, Vector scale, double sign) const {
        const Vector side = along(bar, v), t = Vector(sign) * v.v[R] + side / (Vector(1.0) + bar.v[R]);
        ConeVector<R> found;
        for (int j = 0; j < R; ++j) found.v[j] = scale * (v.v[j] + t * bar.v[j]);
        found.v[R] = scale * (bar.v[R] * v.v[R] + Vector(sign) * side);
        return found;
    }
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
