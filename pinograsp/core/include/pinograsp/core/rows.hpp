// The dual of a force problem with torque rows, and Newton's method on it.
//
// A row R x in [low, high] has a multiplier w, above zero at its upper limit, below at its lower one, and adds
// -max(w low, w high) to the dual (dual.hpp), which thereby has an edge at w = 0. A step is Newton's on the face of the
// rows whose multipliers are not zero and of those that their limits are missed by; multipliers of the latter that it
// would give the wrong sign stay zero. Along a step the dual is concave, edges included, and so the line search is
// exact, too: it ends on an edge, a multiplier then being zero, where the derivative changes its sign there. Rows that
// do not take part cost one product with the forces, and joints of different fingers hardly meet: rows are multiplied
// where they are not zero, and of the face's matrix, which has the balance last, zeros cost nothing.
#pragma once

#include "contact_blocks.hpp"
#include "dual.hpp"
#include "memory.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

template <class K>
class RowDual {
public:
    using Truth = bool;
    static constexpr int patience = 2;  // steps before y is first tested as a ray
    struct Step {
        bool infeasible = false, stalled = false;
    };

    Block<K>* blocks = nullptr;
    int count = 0;
    double b[K::M];
    double *y, *low, *high;  // multipliers of balance and torque rows (M + r), limits of the latter (r)
    double give = 0.0;       // > 0: rows may be missed at a cost of the square over 2 give

    // For blocks of contacts and r torque rows.
    void set_up(int count_, int r, Memory& memory) {
        count = count_;
        r_ = r;
        length_ = K::D * count;
        const int n = K::M + r;
        blocks = memory.part<Block<K>>(count);
        for (double** own : {&y, &step_, &residual_, &right_}) *own = memory.part<double>(n);
        for (double** own : {&low, &high, &value_, &edge_}) *own = memory.part<double>(n);
        for (Vector** own : {&B_, &T_}) *own = memory.part<Vector>(std::size_t(n) * length_);
        x_ = memory.part<Vector>(length_);
        for (double** own : {&S_, &U_}) *own = memory.part<double>(std::size_t(n) * n);
        for (int** own : {&face_, &first_, &last_, &until_, &stay_}) *own = memory.part<int>(n);
        for (int l = 0; l < n; ++l) first_[l] = count * width;
    }

    // Sets the coefficient of component j of a contact in a row, the balance's first; once.
    void set(int r, int j, int contact, double value) {
        in_lane(B_[r * length_ + K::D * (contact / width) + j], contact % width) = value;
        if (value == 0.0) return;
        first_[r] = contact < first_[r] ? contact : first_[r];
        last_[r] = contact < last_[r] ? last_[r] : contact + 1;
    }

    // After the last of these.
    void tie() {
        for (int r = 0; r < rows(); ++r)
            for (int other = until_[r] = r; other < rows(); ++other)
                if (first_[r] < last_[other] && first_[other] < last_[r]) until_[r] = other;
    }

    int rows() const { return K::M + r_; }

    void begin(bool) {
        combine(y, &Block<K>::s);
        for (int i = 0; i < count; ++i) {
            Block<K>& at = blocks[i];
            for (int j = 0; j < K::D; ++j) {
                at.s[j] = at.s[j] + at.q[j];
                at.v[j] = 0.0;
            }
            at.forces_at(Vector(0.0));
        }
    }

    // What is missed of all rows, for the next step; returns its largest entry.
    double residual() {
        double most = 0.0;
        values();
        for (int r = 0; r < rows(); ++r) {
            double off;
            if (r < K::M) {
                off = value_[r] - b[r];
            } else {
                const double at = value_[r], least = low[r - K::M], greatest = high[r - K::M];
                off = y[r] > 0.0 ? at - greatest : y[r] < 0.0 ? at - least : beyond(r - K::M);
            }
            residual_[r] = off - give * y[r];
            most = max(most, std::fabs(residual_[r]));
        }
        largest_ = most;
        return most;
    }

    // One Newton step. Infeasible: y became a ray along which the dual grows without bound, the largest entry 1.
    // `doubtful`: is y itself such a ray?
    Step step(bool, bool doubtful) {
        Step found;
        direct();
        double start = 0.0;
        for (int r = 0; r < rows(); ++r) start += residual_[r] * step_[r];
        if (!(start > 0.0)) {
            found.stalled = true;
            return found;
        }
        if (give == 0.0 && doubtful && proves(y)) {
            normalise(y);
            found.infeasible = true;
            return found;
        }
        combine(step_, &Block<K>::v);
        const double t = search(start, found);
        if (found.infeasible || found.stalled) return found;
        for (int r = 0; r < rows(); ++r) {
            const bool edge = r >= K::M && step_[r] != 0.0 && edge_[r] == t;
            y[r] = edge ? 0.0 : y[r] + t * step_[r];
        }
        for (int i = 0; i < count; ++i)
            for (int j = 0; j < K::D; ++j) blocks[i].s[j] = blocks[i].s[j] + Vector(t) * blocks[i].v[j];
        return found;
    }

    // The least of the rows' sum weighted by the ray, less their limits, of all admissible x.
    double least_along(const double* ray) const {
        Vector total = 0.0;
        for (int i = 0; i < count; ++i) {
            Vector c[K::D];
            slopes(i, ray, c);
            total = total + blocks[i].least(c);
        }
        return sum(total) - limits_along(ray);
    }

    double limits_along(const double* ray) const {
        double found = 0.0;
        for (int r = 0; r < K::M; ++r) found += b[r] * ray[r];
        for (int r = 0; r < r_; ++r) {
            const double w = ray[K::M + r];
            if (w != 0.0) found += w * (w > 0.0 ? high[r] : low[r]);
        }
        return found;
    }

    // The ray's combination of block i's columns.
    void slopes(int i, const double* ray, Vector* out) const {
        for (int j = 0; j < K::D; ++j) out[j] = 0.0;
        for (int r = 0; r < rows(); ++r)
            if (ray[r] != 0.0 && meets(r, i))
                for (int j = 0; j < K::D; ++j) out[j] = out[j] + Vector(ray[r]) * B_[r * length_ + K::D * i + j];
    }

    double missed() {
        double square = 0.0;
        values();
        for (int r = 0; r < K::M; ++r) square += (value_[r] - b[r]) * (value_[r] - b[r]);
        for (int r = 0; r < r_; ++r) square += beyond(r) * beyond(r);
        return std::sqrt(square);
    }

private:
    static constexpr int searches = 60;
    static constexpr double missing = 1e-13;  // of a limit: less is rounding

    int r_ = 0, length_ = 0, faces_ = 0;
    double *step_, *residual_, *right_, *value_, *edge_, largest_ = 0.0;
    double *S_, *U_;              // matrix of the face, its upper triangle, and its factor
    Vector *B_, *T_, *x_;         // rows, these times the derivative of the forces, forces; components side by side
    int *face_, *first_, *last_;  // rows that take part; contacts that rows are not zero for
    int *until_, *stay_;          // the last row that has contacts in common; which of the face stay

    // Whether a row is not zero for block i.
    bool meets(int r, int i) const { return width * (i + 1) > first_[r] && width * i < last_[r]; }

    // Row r times v, over the blocks that have its contacts from the first to the last.
    double along(int r, const Vector* v, int first, int last) const {
        Vector total = 0.0;
        for (int l = K::D * (first / width); l < K::D * blocks_of(last); ++l)
            total = total + B_[r * length_ + l] * v[l];
        return sum(total);
    }

    // Rows times forces.
    void values() {
        for (int i = 0; i < count; ++i)
            for (int j = 0; j < K::D; ++j) x_[K::D * i + j] = blocks[i].x[j];
        for (int r = 0; r < rows(); ++r) value_[r] = along(r, x_, first_[r], last_[r]);
    }

    // The ray's combination of all columns, in the blocks.
    void combine(const double* ray, Vector (Block<K>::*out)[K::D]) {
        for (int i = 0; i < count; ++i)
            for (Vector& one : blocks[i].*out) one = 0.0;
        for (int r = 0; r < rows(); ++r)
            for (int i = first_[r] / width; ray[r] != 0.0 && i < blocks_of(last_[r]); ++i)
                for (int j = 0; j < K::D; ++j) {
                    Vector& one = (blocks[i].*out)[j];
                    one = one + Vector(ray[r]) * B_[r * length_ + K::D * i + j];
                }
    }

    // How far a torque row is above its upper limit, or, negative, below its lower one.
    double beyond(int r) const { return max(value_[K::M + r] - high[r], 0.0) + min(value_[K::M + r] - low[r], 0.0); }

    // The step of the rows that take part, the balance last; zero for the others.
    void direct() {
        faces_ = 0;
        for (int n = 0; n < rows(); ++n) {
            const int r = n < r_ ? K::M + n : n - r_;
            step_[r] = 0.0;
            if (n >= r_ || y[r] != 0.0 || std::fabs(residual_[r]) > missing) face_[faces_++] = r;
        }
        derive();
        multiply();
        while (!solve_face()) {
        }
    }

    // T = the derivative of the forces times the face's rows.
    void derive() {
        Vector unit[K::D][K::D];
        for (int j = 0; j < K::D; ++j)
            for (int c = 0; c < K::D; ++c) unit[j][c] = j == c ? 1.0 : 0.0;
        for (int i = 0; i < count; ++i) {
            Vector X[triangle<K::D>];
            for (Vector& one : X) one = 0.0;
            blocks[i].add_hessian(unit, X);
            for (int n = 0; n < faces_; ++n) {
                const int r = face_[n], at = r * length_ + K::D * i;
                if (!meets(r, i)) continue;
                for (int j = 0; j < K::D; ++j) {
                    Vector t = 0.0;
                    for (int c = 0; c < K::D; ++c)
                        t = t + X[j < c ? upper<K::D>(j, c) : upper<K::D>(c, j)] * B_[at + c];
                    T_[at + j] = t;
                }
            }
        }
    }

    // The face's rows times T.
    void multiply() {
        const int n = faces_, balance = n - K::M;
        for (int m = 0; m < n; ++m) {
            const int r = face_[m];
            double* row = S_ + m * n;
            std::memset(row, 0, n * sizeof(double));
            for (int c = m; c < n; ++c) {
                if (c < balance && face_[c] > until_[r]) c = balance;
                const int at = face_[c], first = first_[r] > first_[at] ? first_[r] : first_[at],
                          last = last_[r] < last_[at] ? last_[r] : last_[at];
                if (first < last) row[c] = along(at, T_ + r * length_, first, last);
            }
        }
    }

    // Solves for the step; false where multipliers that were zero would get the wrong sign: their rows leave the face.
    bool solve_face() {
        const int n = faces_;
        double trace = 0.0;
        for (int m = 0; m < n; ++m) trace += S_[m * (n + 1)];
        const double lift = give + 1e-12 + 1e-14 * trace + min(1e-2, 1e-3 * largest_);
        std::memcpy(U_, S_, std::size_t(n) * n * sizeof(double));
        for (int m = 0; m < n; ++m) {
            U_[m * (n + 1)] += lift;
            right_[m] = residual_[face_[m]];
        }
        factor(U_, n);
        core::solve(U_, right_, n);
        int left = 0;
        for (int m = 0; m < n; ++m) {
            const int r = face_[m];
            if (r < K::M || y[r] != 0.0 || right_[m] * residual_[r] > 0.0) stay_[left++] = m;
        }
        if (left == n) {
            for (int m = 0; m < n; ++m) step_[face_[m]] = right_[m];
            return true;
        }
        for (int m = 0; m < left; ++m) {
            face_[m] = face_[stay_[m]];
            for (int c = m; c < left; ++c) S_[m * left + c] = S_[stay_[m] * n + stay_[c]];
        }
        faces_ = left;
        return false;
    }

    bool proves(const double* ray) const { return least_along(ray) > proven * largest_of(ray); }

    double largest_of(const double* ray) const {
        double size = 1e-300;
        for (int r = 0; r < rows(); ++r) size = max(size, std::fabs(ray[r]));
        return size;
    }

    // y becomes the ray, its largest entry 1.
    void normalise(const double* ray) {
        const double size = largest_of(ray);
        for (int r = 0; r < rows(); ++r) y[r] = ray[r] / size;
    }

    // The derivatives of the dual at y + t step, before an edge there and after it.
    void derivatives_at(double t, double& before, double& after) {
        Vector total = 0.0;
        for (int i = 0; i < count; ++i) {
            Block<K>& at = blocks[i];
            at.forces_at(Vector(t));
            for (int j = 0; j < K::D; ++j) total = total + at.v[j] * at.x[j];
        }
        before = sum(total);
        for (int r = 0; r < K::M; ++r) before -= (b[r] + give * (y[r] + t * step_[r])) * step_[r];
        after = before;
        for (int n = 0; n < faces_ - K::M; ++n) {
            const int r = face_[n], own = r - K::M;
            const double edge = edge_[r], fixed = give * (y[r] + t * step_[r]);
            const bool above = step_[r] > 0.0, first = y[r] != 0.0 ? y[r] > 0.0 : above;
            const double *from = first ? high : low, *to = above ? high : low;
            before -= ((t <= edge ? from : to)[own] + fixed) * step_[r];
            after -= ((t < edge ? from : to)[own] + fixed) * step_[r];
        }
    }

    // The edge between two points that is nearest to t; t where there is none.
    double nearest_edge(double t, double below, double above) const {
        double found = t, far = infinity;
        for (int n = 0; n < faces_ - K::M; ++n) {
            const double edge = edge_[face_[n]];
            if (edge > below && edge < above && std::fabs(edge - t) < far) {
                far = std::fabs(edge - t);
                found = edge;
            }
        }
        return found;
    }

    // How far to go along the step, with the forces there. The derivative falls from `start`: its root by regula falsi
    // (Illinois), edges first.
    double search(double start, Step& found) {
        double below = 0.0, above = infinity, at_below = start, at_above = 0.0, side = 0.0, t = 1.0;
        for (int n = 0; n < faces_ - K::M; ++n) {
            const int r = face_[n];
            edge_[r] = y[r] * step_[r] < 0.0 ? -y[r] / step_[r] : infinity;
        }
        for (int round = 0;; ++round) {
            double before, after;
            derivatives_at(t, before, after);
            const double along = after > 0.0 ? after : min(before, 0.0);
            if (std::fabs(along) <= 0.3 * start || round == searches) return t;
            if (along < 0.0) {
                if (side < 0.0) at_below *= 0.5;
                at_above = along;
                above = t;
                side = -1.0;
            } else {
                if (side > 0.0) at_above *= 0.5;
                at_below = along;
                below = t;
                side = 1.0;
            }
            if (above == infinity) {
                if (round == 1 && give == 0.0 && proves(step_)) {
                    normalise(step_);
                    found.infeasible = true;
                    return t;
                }
                t *= 4.0;
                if (!(t <= 1e14)) {
                    found.stalled = true;
                    return t;
                }
            } else {
                t = nearest_edge(below + at_below * (above - below) / (at_below - at_above), below, above);
            }
        }
    }
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
