// Small dense algebra.
#pragma once

#include "lanes.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// Where entry (r, c) of the upper triangle of a symmetric (M, M) matrix is, r <= c.
template <int M>
constexpr int upper(int r, int c) {
    return r * M - r * (r - 1) / 2 + c - r;
}
template <int M>
constexpr int triangle = M * (M + 1) / 2;

// Factor U' D U of a positive definite matrix, its upper triangle, in place: U with a unit diagonal, and the inverse of
// D there. Small pivots are raised to a floor.
template <int M, class S>
PINOGRASP_INLINE void factor(S* H) {
    S most = H[0];
    PINOGRASP_UNROLL
    for (int r = 1; r < M; ++r) most = max(most, H[upper<M>(r, r)]);
    const S floor = S(1e-15) * most + S(1e-300);
    PINOGRASP_UNROLL
    for (int r = 0; r < M; ++r) {
        const S inverse = S(1.0) / max(H[upper<M>(r, r)], floor);
        H[upper<M>(r, r)] = inverse;
        PINOGRASP_UNROLL
        for (int i = r + 1; i < M; ++i) {
            const S t = H[upper<M>(r, i)] * inverse;
            PINOGRASP_UNROLL
            for (int c = i; c < M; ++c) H[upper<M>(i, c)] = H[upper<M>(i, c)] - t * H[upper<M>(r, c)];
        }
        PINOGRASP_UNROLL
        for (int c = r + 1; c < M; ++c) H[upper<M>(r, c)] = H[upper<M>(r, c)] * inverse;
    }
}

// v <- (U' D U)^-1 v.
template <int M, class S>
PINOGRASP_INLINE void solve(const S* H, S* v) {
    PINOGRASP_UNROLL
    for (int r = 0; r < M; ++r) {
        const S t = v[r];
        PINOGRASP_UNROLL
        for (int c = r + 1; c < M; ++c) v[c] = v[c] - H[upper<M>(r, c)] * t;
        v[r] = t * H[upper<M>(r, r)];
    }
    PINOGRASP_UNROLL
    for (int r = M - 2; r >= 0; --r) {
        S t = v[r];
        PINOGRASP_UNROLL
        for (int c = r + 1; c < M; ++c) t = t - H[upper<M>(r, c)] * v[c];
        v[r] = t;
    }
}

// Whether they are all zero.
PINOGRASP_INLINE bool none_of(const double* from) { return !any(abs(lanes_at(from)) > Vector(0.0)); }

// The same for n rows, known at run time only; H (n, n), of which the upper triangle is used, and the first column for
// itself. The floor of a pivot is its own: the sizes of rows may be far apart.
inline void factor(double* H, int n) {
    for (int r = 1; r < n; ++r) H[r * n] = H[r * (n + 1)];
    for (int r = 0; r < n; ++r) {
        double* row = H + r * n;
        const double inverse = 1.0 / max(row[r], 1e-15 * row[0] + 1e-300);
        row[r] = inverse;
        for (int i = r + 1; i < n; ++i) {
            while (i + width <= n && none_of(row + i)) i += width;
            if (i == n) break;
            const double t = row[i] * inverse;
            if (t == 0.0) continue;
            double* other = H + i * n;
            for (int c = i; c < n; ++c) other[c] -= t * row[c];
        }
        for (int c = r + 1; c < n; ++c) row[c] *= inverse;
    }
}

inline void solve(const double* H, double* v, int n) {
    for (int r = 0; r < n; ++r) {
        const double t = v[r], *row = H + r * n;
        for (int c = r + 1; c < n; ++c) v[c] -= row[c] * t;
        v[r] = t * row[r];
    }
    for (int r = n - 2; r >= 0; --r) {
        const double* row = H + r * n;
        Vector total = 0.0;
        int c = r + 1;
        for (; c + width <= n; c += width) total = total + lanes_at(row + c) * lanes_at(v + c);
        double t = v[r] - sum(total);
        for (; c < n; ++c) t -= row[c] * v[c];
        v[r] = t;
    }
}

// Whether a number is not finite, or absurdly large.
inline bool not_finite(const double* values, std::size_t count) {
    bool fine = true;
    for (std::size_t i = 0; i < count; ++i) fine &= std::fabs(values[i]) < 1e12;
    return !fine;
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
