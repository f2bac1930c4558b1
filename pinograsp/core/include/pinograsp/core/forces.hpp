// One force problem after the other of the same grasp: solve it, check the answer, and write out what its record holds.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <initializer_list>
#include <memory>
#include <vector>

#include "bounds.hpp"
#include "columns.hpp"
#include "interior.hpp"
#include "memory.hpp"
#include "newton.hpp"
#include "rows.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// What a grasp's problems are set up with: all that does not depend on the load. In newtons: objective
// 1/2 x'Px + q'x + constant.
struct GraspSetup {
    int k = 0, m = 6, r = 0;           // contacts, rows of the balance (3 or 6), torque rows
    int d = 3, round = 2;              // components of a force, and those of them in a cone
    bool separates = false;            // its costs have no products: the dual Newton method takes it
    std::vector<double> facets;        // of a polyhedral cone (facets, d - 1)
    std::vector<double> vertices;      // of its polygon, where `round` is 0 (corners, 2)
    std::vector<double> B;             // balance, then torque rows (m + r, d k), by component
    std::vector<double> P;             // (d, d, k)
    std::vector<double> q;             // (d k)
    std::vector<double> R_lo, R_hi;    // (r)
    std::vector<double> correction;    // pseudoinverse of the balance (d k, m)
    std::vector<double> widths;        // component over force in the contact's axes (d k)
    std::vector<double> grasp_matrix;  // contact forces to wrench (6, 3 k)
    std::vector<double> normals;       // of the contacts, world axes (k, 3)
    double constant = 0.0;             // of the objective
    double largest = 0.0;              // diagonal entry of P
    double peak = 0.0;                 // weight of the largest F_n
    double arm = 1.0;                  // moments are divided by it [m]
    double near = 1e-6;                // relative margin of active limits
};

// What no grasp can be set up with: the name of the first such field; none (nullptr) where all can be used.
inline const char* fault_of(const GraspSetup& setup) {
    if (setup.k < 1 || setup.k > most_contacts) return "k";
    if (setup.m != 3 && setup.m != 6) return "m";
    if (setup.r < 0 || setup.r > most_contacts) return "r";
    if (!has_shape(setup.d, setup.round)) return "d, round";
    const std::size_t k = setup.k, m = setup.m, r = setup.r, d = setup.d, n = d * k;
    if (setup.facets.size() % (d - 1) != 0) return "facets";
    if (setup.vertices.size() % 2 != 0 || (setup.round == 0 && setup.vertices.empty())) return "vertices";
    const struct {
        const char* name;
        const std::vector<double>& values;
        std::size_t size;
    } arrays[] = {{"facets", setup.facets, setup.facets.size()},
                  {"vertices", setup.vertices, setup.vertices.size()},
                  {"B", setup.B, (m + r) * n},
                  {"P", setup.P, d * n},
                  {"q", setup.q, n},
                  {"correction", setup.correction, n * m},
                  {"widths", setup.widths, n},
                  {"grasp_matrix", setup.grasp_matrix, 18 * k},
                  {"normals", setup.normals, 3 * k}};
    const auto finite = [](double one) { return std::isfinite(one); };
    for (const auto& one : arrays)
        if (one.values.size() != one.size || !std::all_of(one.values.begin(), one.values.end(), finite))
            return one.name;
    if (setup.R_lo.size() != r) return "R_lo";
    if (setup.R_hi.size() != r) return "R_hi";
    for (std::size_t i = 0; i < r; ++i)
        if (!(setup.R_lo[i] <= setup.R_hi[i])) return "R_lo, R_hi";
    const auto is_size = [](double one) { return std::isfinite(one) && one >= 0.0; };
    if (!is_size(setup.constant)) return "constant";
    if (!is_size(setup.largest)) return "largest";
    if (!is_size(setup.arm) || setup.arm == 0.0) return "arm";
    if (!is_size(setup.near)) return "near";
    if (!is_size(setup.peak)) return "peak";
    return nullptr;
}

// The dual Newton method for problems of any shape, whose costs have no products.
class Separable {
public:
    virtual ~Separable() = default;
    virtual Code solve(const Problem& problem, double* x, double* y, int& steps) = 0;
    // The forces that miss the least of balance and torque rows, and multipliers that prove it; see `core::closest`.
    virtual Code closest(const Problem& problem, double* x, double* y, int& steps) = 0;
};

// By the dual `Of`, with torque rows or without.
template <class K, class Of>
class SeparableOf final : public Separable {
    static constexpr bool limited = std::is_same_v<Of, RowDual<K>>;

public:
    explicit SeparableOf(const GraspSetup& setup) : blocks_(blocks_of(setup.k)) {
        if constexpr (limited) {
            method_.dual.set_up(blocks_, setup.r, memory_);
        } else {
            method_.dual.blocks = memory_.part<Block<K>>(blocks_);
            method_.dual.count = blocks_;
        }
        method_.costs = memory_.part<Cost<K>>(blocks_);
        best_ = memory_.part<Vector>(blocks_ * K::D);
        if constexpr (K::fine) take_polygon(setup.facets.data(), static_cast<int>(setup.vertices.size()) / 2);
        for (int i = 0; i < blocks_; ++i) {
            method_.dual.blocks[i].blank();
            if constexpr (K::fine) method_.dual.blocks[i].polygon = &polygon_;
            for (int j = 0; j < K::D; ++j) {
                method_.costs[i].P[j] = 1.0;
                method_.costs[i].q[j] = 0.0;
            }
        }
        const int n = K::D * setup.k;
        for (int row = 0; row < setup.m + (limited ? setup.r : 0); ++row)
            for (int l = 0; l < n; ++l) {
                const int j = l / setup.k, i = l % setup.k;
                const double value = setup.B[row * n + l];
                if (row < setup.m) in_lane(method_.dual.blocks[i / width].a[j][row], i % width) = value;
                if constexpr (limited) method_.dual.set(row < setup.m ? row : K::M + row - setup.m, j, i, value);
            }
        if constexpr (limited) method_.dual.tie();
    }

    Code solve(const Problem& problem, double* x, double* y, int& steps) override {
        const double least = lay_out(problem);
        method_.powers = problem.powers.count;
        for (int a = 0; a < problem.powers.count; ++a) {
            method_.coefficients[a] = problem.powers.coefficients[a];
            method_.exponents[a] = problem.powers.exponents[a];
        }
        const Code code = minimise(method_, least, steps);
        take(problem, x, y);
        return code;
    }

    Code closest(const Problem& problem, double* x, double* y, int& steps) override {
        lay_out(problem);
        for (int i = 0; i < blocks_; ++i) {
            for (Vector& one : method_.dual.blocks[i].w) one = 1.0;
            method_.dual.blocks[i].weigh();
        }
        const Code code = core::closest(method_.dual, best_, Newton<K, double>::most_steps, steps);
        take(problem, x, y);
        return code;
    }

private:
    int blocks_;
    Memory memory_;
    Newton<K, double, Of> method_;
    Polygon polygon_{};
    Vector* best_;

    // Half of the facets are opposite to the others.
    void take_polygon(const double* facets, int corners) {
        double* directions = memory_.part<double>(corners);
        polygon_.count = corners / 2;
        for (int a = 0; a < polygon_.count; ++a) {
            const double *facet = facets + a * K::E, size = std::sqrt(facet[0] * facet[0] + facet[1] * facet[1]);
            for (int j = 0; j < 2; ++j) directions[2 * a + j] = facet[j] / size;
            polygon_.sizes[0] = 1.0 / size;
        }
        polygon_.sizes[1] = std::sqrt(max(1.0 - polygon_.sizes[0] * polygon_.sizes[0], 0.0));
        polygon_.directions = directions;
    }

    // All contacts and what the rows shall be; returns the least entry of P.
    double lay_out(const Problem& problem) {
        double least = infinity;
        for (int i = 0; i < blocks_; ++i)
            for (Vector& one : method_.dual.blocks[i].x) one = 0.0;  // also of lanes without a contact
        for (int i = 0; i < problem.k; ++i) least = min(least, lay_out(problem, i));
        for (int r = 0; r < K::M; ++r) {
            method_.dual.b[r] = r < problem.m ? problem.b[r] : 0.0;
            method_.dual.y[r] = 0.0;
        }
        if constexpr (limited) {
            for (int r = 0; r < problem.r; ++r) {
                method_.dual.y[K::M + r] = 0.0;
                method_.dual.low[r] = problem.R_lo[r];
                method_.dual.high[r] = problem.R_hi[r];
            }
        }
        return least;
    }

    void take(const Problem& problem, double* x, double* y) const {
        const int k = problem.k;
        for (int i = 0; i < k; ++i)
            for (int j = 0; j < K::D; ++j) x[j * k + i] = in_lane(method_.dual.blocks[i / width].x[j], i % width);
        for (int r = 0; r < problem.m; ++r) y[r] = method_.dual.y[r];
        if constexpr (limited)
            for (int r = 0; r < problem.r; ++r) y[problem.m + r] = method_.dual.y[K::M + r];
    }

    // Contact i in its lane; returns the least entry of its P.
    double lay_out(const Problem& problem, int i) {
        const int k = problem.k, lane = i % width;
        Block<K>& at = method_.dual.blocks[i / width];
        Cost<K>& cost = method_.costs[i / width];
        double least = infinity;
        for (int j = 0; j < K::D; ++j) {
            const double own = problem.P[(j * K::D + j) * k + i];
            least = min(least, own);
            in_lane(cost.P[j], lane) = own;
            in_lane(cost.q[j], lane) = problem.q[j * k + i];
            in_lane(at.x[j], lane) = j < K::E ? 0.0 : min(max(2.0 / k, problem.lo[i]), problem.hi[i]);
        }
        in_lane(at.lo, lane) = problem.lo[i];
        in_lane(at.hi, lane) = problem.hi[i];
        return least;
    }
};

// None (nullptr) for a polygon whose facets are not those of its corners.
inline std::unique_ptr<Separable> make_separable(const GraspSetup& setup) {
    const int corners = static_cast<int>(setup.vertices.size()) / 2;
    const bool fine = setup.round == 0 && corners > 4;
    if (fine && (corners % 2 != 0 || setup.facets.size() < std::size_t(corners) * (setup.d - 1))) return nullptr;
    return of_shape(setup.d, setup.round, corners, [&](auto shape) -> std::unique_ptr<Separable> {
        using K = decltype(shape);
        if (setup.r > 0) return std::make_unique<SeparableOf<K, RowDual<K>>>(setup);
        return std::make_unique<SeparableOf<K, Dual<K, double>>>(setup);
    });
}

// An answer with its checks, dimensionless.
struct Checked {
    Code code = Code::stalled;
    bool newton = false;     // by the dual Newton method
    double violation = 0.0;  // of friction, bounds and torque rows
    double value = 0.0, bound = 0.0;
};

// What one load gives: dimensionless but for `scale` and `unit`, what forces [N] and the objective were divided by.
struct Outcome {
    Checked checked;
    double most = 0.0;                 // largest F_n
    double constant = 0.0;             // of the objective
    double force = 0.0, moment = 0.0;  // what the balance misses
    double scale = 0.0, unit = 0.0;
};

// Within which an answer counts as certified, relative to load, largest force and objective; an objective of less than
// `negligible` counts as `vanishing`.
struct Tolerance {
    double residual = 1e-6, violation = 1e-6, gap = 1e-6, vanishing = 1e-2, negligible = 1e-6;
};

// Why an answer can be trusted, in newtons and the objective's unit.
struct Certificate {
    double objective = 0.0, lower_bound = 0.0;
    double residual_norm = 0.0, violation = 0.0, load_size = 0.0, force_size = 0.0, objective_size = 0.0;
    bool optimal = false;  // within the tolerance; false where a number is none

    Certificate(const Outcome& found, const Tolerance& tolerance) {
        const Checked& checked = found.checked;
        if (checked.code != Code::converged) return;
        // No objective is negative; rounding may raise a sharp bound above the value.
        const double least = min(max(checked.bound, -found.constant), checked.value),
                     value = checked.value + found.constant;
        objective = value * found.unit;
        lower_bound = (least + found.constant) * found.unit;
        residual_norm = std::sqrt(found.force * found.force + found.moment * found.moment) * found.scale;
        violation = max(checked.violation, 0.0) * found.scale;
        load_size = found.scale;
        force_size = max(1.0, found.most) * found.scale;
        const double usual = max(1.0, std::fabs(found.constant)), size = std::fabs(value);
        objective_size = (size < tolerance.negligible * usual ? tolerance.vanishing * usual : size) * found.unit;
        optimal = std::isfinite(checked.bound) && residual_norm <= tolerance.residual * load_size &&
                  violation <= tolerance.violation * force_size &&
                  objective - lower_bound <= tolerance.gap * objective_size;
    }
};

// Where the results of one load go.
struct Record {
    double *wrench = nullptr, *forces = nullptr, *torsion = nullptr;  // residual (6), (k, 3), (k) [N, N m]
    bool *at_friction = nullptr, *at_least = nullptr, *at_most = nullptr, *at_torque = nullptr;  // (k), (r)
};

class Forces {
public:
    // Of a set-up without a fault, see `fault_of`.
    explicit Forces(const GraspSetup& setup)
        : k_(setup.k),
          d_(setup.d),
          m_(setup.m),
          r_(setup.r),
          setup_(setup),
          interior_(d_, setup.round, static_cast<int>(setup.facets.size()) / (d_ - 1), k_, m_, r_, setup.peak > 0.0) {
        const std::size_t n = d_ * k_;
        B_ = memory_.copy(setup_.B.data(), setup_.B.size());
        friction_.d = d_;
        friction_.round = setup_.round;
        friction_.facets = static_cast<int>(setup_.facets.size()) / (d_ - 1);
        friction_.C = memory_.copy(setup_.facets.data(), setup_.facets.size());
        friction_.corners = static_cast<int>(setup_.vertices.size()) / 2;
        friction_.vertices = memory_.copy(setup_.vertices.data(), setup_.vertices.size());
        P_ = memory_.part<double>(d_ * n);
        for (double** own : {&q_, &x_}) *own = memory_.part<double>(n);
        for (double** own : {&lo_, &hi_, &gauge_}) *own = memory_.part<double>(k_);
        for (double** own : {&R_lo_, &R_hi_}) *own = memory_.part<double>(r_);
        y_ = memory_.part<double>(m_ + r_);
        separable_ = make_separable(setup_);
    }

    int contacts() const { return k_; }
    int components() const { return d_; }
    int balance_rows() const { return m_; }
    int torque_rows() const { return r_; }
    bool has_peak() const { return setup_.peak > 0.0; }

    // A problem of this grasp's rows, without powers.
    Problem problem(const double* b, const double* lo, const double* hi, const double* R_lo, const double* R_hi,
                    const double* P, const double* q) const {
        Problem found;
        found.k = k_;
        found.m = m_;
        found.r = r_;
        found.friction = friction_;
        found.B = B_;
        found.b = b;
        found.lo = lo;
        found.hi = hi;
        found.R_lo = R_lo;
        found.R_hi = R_hi;
        found.P = P;
        found.q = q;
        return found;
    }

    // For such a problem: x (d k), y (m + r), gauge (k), residual (m).
    Checked answer(bool newton, const Problem& problem) {
        Checked out;
        int steps = 0;
        out.newton = newton && setup_.separates && separable_ != nullptr;
        if (out.newton) {
            out.code = separable_->solve(problem, x_, y_, steps);
            out.newton = out.code != Code::stalled;
        }
        if (!out.newton) out.code = interior_.solve(problem, 0.0, x_, y_, steps);
        if (out.code == Code::converged) restore_balance(problem);
        const double most = violation(problem, out.violation);
        if (out.code == Code::converged && !(out.violation <= sharp * most)) out.code = Code::stalled;
        const Bound bound = bound_of(problem, x_, y_);
        out.value = bound.value;
        out.bound = bound.bound;
        return out;
    }
    const double* x() const { return x_; }
    const double* y() const { return y_; }
    const double* gauge() const { return gauge_; }
    const double* residual() const { return residual_; }

    // From a load (6) [N, N m], limits of F_n (k) [N] and powers of F_n (t pairs) to all that its record holds.
    Outcome solve(bool newton, const double* least, const double* greatest, const double* terms, int t,
                  const double* load, const Record& record) {
        Outcome out;
        double b[6];
        const double scale = scale_load(load, least, greatest, b);
        if (scale == 0.0) return out;
        double unit = max(0.5 * setup_.largest * scale * scale, setup_.peak * scale);
        for (int a = 0; a < t; ++a) unit = max(unit, terms[2 * a] * std::pow(scale, terms[2 * a + 1]));
        if (!(unit > 0.0)) unit = 1.0;
        scale_to(scale, unit);
        Problem problem = this->problem(b, lo_, hi_, R_lo_, R_hi_, P_, q_);
        problem.peak = setup_.peak * scale / unit;
        if (!powers_of(terms, t, scale, unit, problem.powers)) return out;
        out.checked = answer(newton, problem);
        if (out.checked.code != Code::converged) return out;
        out.scale = scale;
        out.unit = unit;
        out.constant = setup_.constant / unit;
        for (int i = 0; i < k_; ++i) out.most = max(out.most, x_[(d_ - 1) * k_ + i]);
        for (int r = 0; r < m_; ++r) (r < 3 ? out.force : out.moment) += residual_[r] * residual_[r];
        out.force = std::sqrt(out.force);
        out.moment = std::sqrt(out.moment);
        write_forces(scale, load, record);
        write_active(problem, record);
        return out;
    }

    // What any admissible forces miss at least [N] of balance and torque rows, along the direction (m + r), a unit
    // vector; 0: not proven. The record holds the closest forces, and the limits that the proof pushes them against.
    double prove(const double* least, const double* greatest, const double* load, const Record& record,
                 double* direction) {
        double b[6], square = 0.0, worst = 0.0;
        const double scale = scale_load(load, least, greatest, b);
        if (scale == 0.0 || separable_ == nullptr) return 0.0;
        scale_to(scale, 1.0);
        const Problem problem = this->problem(b, lo_, hi_, R_lo_, R_hi_, P_, q_);
        int steps = 0;
        if (separable_->closest(problem, x_, y_, steps) != Code::infeasible) return 0.0;
        for (int r = 0; r < m_ + r_; ++r) square += y_[r] * y_[r];
        for (int r = 0; r < m_ + r_; ++r) direction[r] = y_[r] /= std::sqrt(square);
        const double margin = excluded(problem, y_);
        if (!(margin > proven)) return 0.0;
        violation(problem, worst);
        write_forces(scale, load, record);
        write_pushed(problem, record);
        return margin * scale;
    }

private:
    // Relative to the load or the largest F_n: answers that miss limits by more fail.
    static constexpr double sharp = 1e-9;

    int k_, d_, m_, r_;
    const GraspSetup setup_;
    Friction friction_;
    Interior interior_;
    Memory memory_;
    std::unique_ptr<Separable> separable_;
    const double* B_;
    double *P_, *q_, *x_, *lo_, *hi_, *gauge_, *R_lo_, *R_hi_, *y_, residual_[6] = {};

    // The balance's right-hand side b and the limits of F_n over the scale, which is returned [N]; 0: limits that leave
    // no room.
    double scale_load(const double* load, const double* least, const double* greatest, double* b) {
        double square = 0.0;
        for (int r = 0; r < m_; ++r) {
            b[r] = r < 3 ? -load[r] : -load[r] / setup_.arm;
            square += b[r] * b[r];
        }
        double scale = std::sqrt(square);
        for (int i = 0; i < k_ && square == 0.0; ++i) scale = max(scale, least[i]);
        for (int i = 0; i < k_; ++i) {
            lo_[i] = least[i] / scale;
            hi_[i] = greatest[i] / scale;
            if (!(hi_[i] - lo_[i] > 1e-9 * hi_[i])) return 0.0;
        }
        for (int r = 0; r < m_; ++r) b[r] /= scale;
        return scale;
    }

    // Objective and torque rows over these.
    void scale_to(double scale, double unit) {
        const double heavy = scale * scale / unit, light = scale / unit;
        for (int l = 0; l < d_ * d_ * k_; ++l) P_[l] = setup_.P[l] * heavy;
        for (int l = 0; l < d_ * k_; ++l) q_[l] = setup_.q[l] * light;
        for (int h = 0; h < r_; ++h) {
            R_lo_[h] = setup_.R_lo[h] / scale;
            R_hi_[h] = setup_.R_hi[h] / scale;
        }
    }

    // The residual of the balance, after a correction of x where rounding left one.
    void restore_balance(const Problem& problem) {
        const int n = d_ * k_;
        for (int again = 0; again < 2; ++again) {
            double square = 0.0;
            for (int r = 0; r < m_; ++r) {
                double total = -problem.b[r];
                for (int l = 0; l < n; ++l) total += problem.B[r * n + l] * x_[l];
                residual_[r] = total;
                square += total * total;
            }
            if (again || square <= 1e-26) return;
            for (int l = 0; l < n; ++l)
                for (int r = 0; r < m_; ++r) x_[l] -= setup_.correction[l * m_ + r] * residual_[r];
        }
    }

    // The largest violation of friction, bounds and torque rows; returns the largest F_n or 1. Fills the gauges.
    double violation(const Problem& problem, double& worst) {
        const Friction& friction = problem.friction;
        const int e = d_ - 1, n = d_ * k_;
        double most = 1.0;
        worst = 0.0;
        for (int i = 0; i < k_; ++i) {
            const double F = x_[e * k_ + i];
            double length = 0.0;
            for (int j = 0; j < friction.round; ++j) length += x_[j * k_ + i] * x_[j * k_ + i];
            length = std::sqrt(length);
            for (int a = 0; a < friction.facets; ++a) {
                double t = 0.0;
                for (int j = 0; j < e; ++j) t += friction.C[a * e + j] * x_[j * k_ + i];
                length = max(length, t);
            }
            gauge_[i] = length;
            most = max(most, F);
            worst = max(worst, max(length - F, max(problem.lo[i] - F, F - problem.hi[i])));
        }
        for (int h = 0; h < r_; ++h) {
            double t = 0.0;
            for (int l = 0; l < n; ++l) t += problem.B[(m_ + h) * n + l] * x_[l];
            worst = max(worst, max(t - problem.R_hi[h], problem.R_lo[h] - t));
        }
        return most;
    }

    // Forces and torsion, and what they and the load leave over.
    void write_forces(double scale, const double* load, const Record& record) const {
        std::memcpy(record.wrench, load, 6 * sizeof(double));
        for (int i = 0; i < k_; ++i) {
            double* f = record.forces + 3 * i;
            for (int c = 0; c < 3; ++c) {
                const int l = (c == 2 ? d_ - 1 : c) * k_ + i;
                f[c] = x_[l] * scale * setup_.widths[l];
            }
            record.torsion[i] = d_ == 4 ? x_[2 * k_ + i] * scale * setup_.widths[2 * k_ + i] : 0.0;
            for (int c = 0; c < 3; ++c) record.wrench[3 + c] += record.torsion[i] * setup_.normals[3 * i + c];
            for (int r = 0; r < 6; ++r)
                for (int c = 0; c < 3; ++c) record.wrench[r] += setup_.grasp_matrix[(r * k_ + i) * 3 + c] * f[c];
        }
    }

    // Which limits multipliers y push forces x against; gauges are those of x.
    void write_pushed(const Problem& problem, const Record& record) const {
        constexpr double near = 1e-5, slipping = 1e-3;
        const int n = d_ * k_, e = d_ - 1;
        for (int i = 0; i < k_; i += width) {
            Vector g[4];
            for (int j = 0; j < d_; ++j) {
                g[j] = 0.0;
                for (int r = 0; r < m_ + r_; ++r)
                    g[j] = g[j] + Vector(y_[r]) * next_of(B_ + r * n + j * k_ + i, k_ - i);
            }
            const Vector pulls = support(problem.friction, g), slope = g[e] - pulls;
            for (int l = 0; l < width && i + l < k_; ++l) {
                const int at = i + l;
                const double F = x_[e * k_ + at], s = in_lane(slope, l);
                record.at_friction[at] = in_lane(pulls, l) > near && F > 0.0 && gauge_[at] >= F * (1.0 - slipping);
                record.at_least[at] = s > near && lo_[at] + near * (1.0 + lo_[at]) >= F;
                record.at_most[at] = s < -near && hi_[at] - near * (1.0 + hi_[at]) <= F;
            }
        }
        for (int h = 0; h < r_; ++h) record.at_torque[h] = std::fabs(y_[m_ + h]) > near;
    }

    // Which limits are active.
    void write_active(const Problem& problem, const Record& record) const {
        const double near = setup_.near;
        const int n = d_ * k_;
        for (int i = 0; i < k_; ++i) {
            const double F = x_[(d_ - 1) * k_ + i];
            record.at_friction[i] = gauge_[i] >= F * (1.0 - near);
            record.at_least[i] = lo_[i] * (1.0 + near) >= F;
            record.at_most[i] = hi_[i] * (1.0 - near) <= F;
        }
        for (int h = 0; h < r_; ++h) {
            double t = 0.0;
            for (int l = 0; l < n; ++l) t += problem.B[(m_ + h) * n + l] * x_[l];
            record.at_torque[h] = t >= R_hi_[h] - near || t <= R_lo_[h] + near;
        }
    }
};

// The problems of a grasp; none (nullptr) where the set-up has a fault, see `fault_of`.
inline std::unique_ptr<Forces> make_forces(const GraspSetup& setup) {
    return fault_of(setup) == nullptr ? std::make_unique<Forces>(setup) : nullptr;
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
