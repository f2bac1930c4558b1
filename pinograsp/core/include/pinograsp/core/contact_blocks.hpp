// The contacts' own (D, D) blocks of a Newton system, `width` contacts at a time, and products with rows.
//
// Vectors over all contacts are stored by component: entry j blocks + b is component j of the contacts of block b.
#pragma once

#include "algebra.hpp"
#include "lanes.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

PINOGRASP_INLINE double smallest(Vector a) { return -largest(-a); }

// Cholesky factor U'U of a block, its upper triangle, in place, inverse pivots on the diagonal; small pivots are raised
// to a floor. With D = 4 only the last pivot is measured by its own size, too: F_n may be much stiffer than the others.
template <int D>
PINOGRASP_INLINE void factor_contacts(Vector* h) {
    constexpr auto at = upper<D>;
    const Vector one = 1.0, floor = Vector(1e-15) * max(max(h[0], h[at(1, 1)]), h[at(2, 2)]) + Vector(1e-300);
    const Vector last = max(floor, Vector(1e-15) * h[at(D - 1, D - 1)]);
    for (int r = 0; r < D; ++r) {
        Vector pivot = h[at(r, r)];
        for (int i = 0; i < r; ++i) pivot = pivot - h[at(i, r)] * h[at(i, r)];
        const Vector scale = one / sqrt(max(pivot, r == 3 ? last : floor));
        h[at(r, r)] = scale;
        for (int c = r + 1; c < D; ++c) {
            Vector t = h[at(r, c)];
            for (int i = 0; i < r; ++i) t = t - h[at(i, r)] * h[at(i, c)];
            h[at(r, c)] = t * scale;
        }
    }
}

// v <- U'^-1 v for the factor U of a block.
template <int D>
PINOGRASP_INLINE void half_solve(const Vector* U, Vector* v) {
    for (int j = 0; j < D; ++j) {
        for (int c = 0; c < j; ++c) v[j] = v[j] - U[upper<D>(c, j)] * v[c];
        v[j] = v[j] * U[upper<D>(j, j)];
    }
}

// v <- U^-1 v.
template <int D>
PINOGRASP_INLINE void back_solve(const Vector* U, Vector* v) {
    for (int j = D - 1; j >= 0; --j) {
        for (int c = j + 1; c < D; ++c) v[j] = v[j] - U[upper<D>(j, c)] * v[c];
        v[j] = v[j] * U[upper<D>(j, j)];
    }
}

PINOGRASP_INLINE double dot(const Vector* a, const Vector* b, int length) {
    Vector total = 0.0;
    for (int l = 0; l < length; ++l) total = total + a[l] * b[l];
    return sum(total);
}

// out[c] = row . others[c] for N rows next to each other.
template <int N>
PINOGRASP_INLINE void dots(const Vector* row, const Vector* others, int length, double* out) {
    Vector total[N];
    for (int c = 0; c < N; ++c) total[c] = 0.0;
    for (int l = 0; l < length; ++l)
        for (int c = 0; c < N; ++c) total[c] = total[c] + row[l] * others[c * length + l];
    for (int c = 0; c < N; ++c) out[c] = sum(total[c]);
}

// S = T B', its upper triangle; T, B (rows, length).
inline void inner_products(const Vector* T, const Vector* B, int rows, int length, double* S) {
    for (int r = 0; r < rows; ++r) {
        int c = r;
        for (; c + 4 <= rows; c += 4) dots<4>(T + r * length, B + c * length, length, S + r * rows + c);
        for (; c < rows; ++c) dots<1>(T + r * length, B + c * length, length, S + r * rows + c);
    }
}

// out += sign A' y; A (rows, length).
inline void add_combination(const Vector* A, int rows, int length, const double* y, double sign, Vector* out) {
    for (int l = 0; l < length; ++l) {
        Vector total = 0.0;
        for (int r = 0; r < rows; ++r) total = total + Vector(y[r]) * A[r * length + l];
        out[l] = out[l] + Vector(sign) * total;
    }
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
