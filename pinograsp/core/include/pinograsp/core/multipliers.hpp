// Least squares in a box: the multipliers (k1, k2) of the friction pyramids' edges at fixed normal forces.
//
// Minimise 1/2 |H k + b|^2 + eps/2 |k|^2 over |k| <= 1 by Newton's method on the dual, whose unknowns y (m) are the
// residual: k_j = -h_j . y / eps clipped to [-1, 1] leaves y - H k - b = 0, the gradient of a strongly convex function.
#pragma once

#include "algebra.hpp"
#include "memory.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

template <int M>
class BoxLeastSquares {
public:
    // H (M, n), row by row.
    BoxLeastSquares(const double* H, int n, double eps)
        : n_(n), count_(blocks_of(n)), inverse_(1.0 / eps), columns_(memory_.part<Column>(count_)) {
        for (int j = 0; j < n; ++j)
            for (int r = 0; r < M; ++r) in_lane(columns_[j / width].h[r], j % width) = H[r * n + j];
    }

    // The least squares for b (M); k (n). False: it did not converge, or b is no number.
    bool solve(const double* b, double* k) {
        double most = 0.0;
        for (int r = 0; r < M; ++r) {
            if (!(std::fabs(b[r]) < 1e12)) return false;
            most = max(most, std::fabs(b[r]));
            y_[r] = 0.0;
        }
        for (int i = 0; i < count_; ++i) columns_[i].s = 0.0;
        for (int step = 0; step < steps; ++step) {
            if (evaluate(b) <= 1e-12 * (1.0 + most)) {
                for (int j = 0; j < n_; ++j) k[j] = in_lane(columns_[j / width].k, j % width);
                return true;
            }
            for (int r = 0; r < M; ++r) d_[r] = g_[r];
            factor<M>(hessian_);
            core::solve<M>(hessian_, d_);
            for (int i = 0; i < count_; ++i) columns_[i].v = along(columns_[i], d_);
            const double t = length(b);
            for (int r = 0; r < M; ++r) y_[r] -= t * d_[r];
            for (int i = 0; i < count_; ++i) columns_[i].s = columns_[i].s - Vector(t) * columns_[i].v;
        }
        return false;
    }

private:
    static constexpr int steps = 60, searches = 60;

    // `width` columns of H, their unknowns k, and s = h . y, v = h . d.
    struct Column {
        Vector h[M], k, s, v;
    };

    int n_, count_;
    double inverse_;
    Memory memory_;
    Column* columns_;
    double y_[M], g_[M], d_[M], hessian_[triangle<M>];

    static Vector along(const Column& column, const double* y) {
        Vector total = column.h[0] * Vector(y[0]);
        for (int r = 1; r < M; ++r) total = total + column.h[r] * Vector(y[r]);
        return total;
    }

    static Vector clipped(Vector value) { return clamp(value, -1.0, 1.0); }

    // k, gradient and Hessian at y; returns the largest entry of the gradient.
    double evaluate(const double* b) {
        Vector g[M], H[triangle<M>];
        for (Vector& one : g) one = 0.0;
        for (Vector& one : H) one = 0.0;
        for (int i = 0; i < count_; ++i) {
            Column& at = columns_[i];
            at.k = clipped(-at.s * Vector(inverse_));
            const Vector weight = select(abs(at.k) < Vector(1.0), Vector(inverse_), Vector(0.0));
            PINOGRASP_UNROLL
            for (int r = 0; r < M; ++r) {
                g[r] = g[r] + at.h[r] * at.k;
                const Vector t = weight * at.h[r];
                PINOGRASP_UNROLL
                for (int c = r; c < M; ++c) H[upper<M>(r, c)] = H[upper<M>(r, c)] + t * at.h[c];
            }
        }
        double size = 0.0;
        PINOGRASP_UNROLL
        for (int r = 0; r < M; ++r) {
            g_[r] = y_[r] - b[r] - sum(g[r]);
            size = max(size, std::fabs(g_[r]));
            PINOGRASP_UNROLL
            for (int c = r; c < M; ++c) hessian_[upper<M>(r, c)] = sum(H[upper<M>(r, c)]) + (r == c ? 1.0 : 0.0);
        }
        return size;
    }

    // How far to go along -d. The derivative falls from its value at 0: its root (regula falsi, Illinois).
    double length(const double* b) const {
        double start = 0.0, line = 0.0, square = 0.0;
        for (int r = 0; r < M; ++r) {
            line += (y_[r] - b[r]) * d_[r];
            square += d_[r] * d_[r];
            start += g_[r] * d_[r];
        }
        double below = 0.0, above = -1.0, at_below = start, at_above = 0.0, t = 1.0;
        int side = 0;
        for (int search = 0; search < searches; ++search) {
            Vector part = 0.0;
            for (int i = 0; i < count_; ++i) {
                const Column& at = columns_[i];
                part = part + at.v * clipped(-(at.s - Vector(t) * at.v) * Vector(inverse_));
            }
            const double rest = line - t * square - sum(part);
            if (std::fabs(rest) <= 0.1 * start) break;
            if (rest < 0.0) {
                above = t;
                at_above = rest;
                if (side < 0) at_below *= 0.5;
                side = -1;
            } else {
                below = t;
                at_below = rest;
                if (side > 0) at_above *= 0.5;
                side = 1;
            }
            t = above < 0.0 ? 4.0 * t : below + at_below * (above - below) / (at_below - at_above);
        }
        return t;
    }
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
