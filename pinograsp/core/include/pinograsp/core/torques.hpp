// The forces of one tick where joints have limits: the interior-point method with rows for the joints.
#pragma once

#include <cstring>
#include <vector>

#include "bounds.hpp"
#include "columns.hpp"
#include "interior.hpp"
#include "memory.hpp"
#include "newton.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// A joint that moves a contact, and its column of the Jacobian: a joint that follows others has a column of its own,
// which counts for the one that it follows.
struct Link {
    int contact, column, joint;
};

// What the rows are made from, see `Online`.
struct TorqueInputs {
    const double *points, *rotations, *com, *jacobian, *gravity, *limit, *coupled;
    double borne;
};

template <class K>
class TorqueLimits {
public:
    TorqueInputs inputs{};

    TorqueLimits(int k, int m, int joints, const std::vector<Link>& links, const std::vector<int>& limited,
                 int couplings, const std::vector<double>& coupling_rows, const std::vector<int>& stops)
        : k_(k),
          m_(m),
          n_(joints),
          couplings_(couplings),
          links_(links),
          coupling_rows_(coupling_rows),
          stops_(stops),
          rows_(count_rows(limited)),
          interior_(K::D, K::R, facets, k, m, rows_) {
        const std::size_t n = K::D * k;
        B_ = memory_.part<double>((m_ + rows_) * n);
        P_ = memory_.part<double>(K::D * n);
        every_ = memory_.part<double>(couplings ? n_ * n : 0);
        y_ = memory_.part<double>(m_ + rows_);
        for (double** own : {&q_, &x_, &best_}) *own = memory_.part<double>(n);
        for (double** own : {&lo_, &hi_}) *own = memory_.part<double>(k);
        for (double** own : {&R_lo_, &R_hi_}) *own = memory_.part<double>(rows_);
        facets_of();
    }

    // |gravity + J'f| <= limit. The dual's forces are the result; where the load cannot be held within the limits they
    // become the closest forces; where no forces keep the limits they stay as they are.
    template <class Unit>
    Code solve(Dual<K, double>& dual, double scale, const Unit& unit, int& steps) {
        lay_out(dual, unit);
        set_ranges(scale);
        const Problem problem = this->problem(dual.b);
        int used = 0;
        Code code = interior_.solve(problem, 0.0, x_, y_, used);
        steps += used;
        if (code != Code::converged) {
            const Code nearest = closest_within(problem, dual, steps);
            if (nearest == Code::converged) return code;
            code = nearest;
        } else if (not_finite(x_, K::D * k_)) {
            return Code::stalled;
        }
        into_cones(dual);
        const bool held = judge(dual.blocks, dual.count, dual.b).balance <= 1e-9;
        return code == Code::converged && !held ? Code::stalled : code;
    }

private:
    static constexpr int facets = 2 * (K::E - K::R);
    // Of the load, by which a coupling may be missed: programs without room are hard.
    static constexpr double trace = 1e-6;
    // Forces are the closest where what they leave of the balance is this near to its proven least value.
    static constexpr double close_enough = 1e-6;

    int k_, m_, n_, couplings_;
    std::vector<Link> links_;
    std::vector<double> coupling_rows_;
    std::vector<int> stops_;            // which side of a coupling a joint's end takes; none: neither of any
    std::vector<int> row_of_, low_of_;  // row of a joint, first of the two rows of a coupling; -1 for none
    int rows_;
    Interior interior_;
    Memory memory_;
    double *B_, *P_, *q_, *lo_, *hi_, *R_lo_, *R_hi_, *x_, *best_, *y_, *every_;
    double C_[facets ? facets * K::E : 1] = {}, corners_[8] = {};

    // Joints that no contact loads have no row.
    int count_rows(const std::vector<int>& limited) {
        std::vector<bool> moves(n_, false);
        for (const Link& link : links_) moves[link.joint] = true;
        row_of_.assign(n_, -1);
        low_of_.assign(couplings_, -1);
        int count = 0;
        for (int j : limited)
            if (moves[j]) row_of_[j] = count++;
        for (int c = 0; c < couplings_; ++c)
            for (int j = 0; j < n_ && low_of_[c] < 0; ++j)
                if (moves[j] && coupling_rows_[c * n_ + j] != 0.0) {
                    low_of_[c] = count;
                    count += 2;
                }
        return count;
    }

    void facets_of() {
        for (int a = 0; a < facets; ++a) {
            const int j = K::R + a / 2;
            C_[a * K::E + j] = (a % 2 ? 1.0 : -1.0) / K::radius(j);
        }
        for (int a = 0; a < 4; ++a) {
            corners_[2 * a] = a % 2 ? K::radius(0) : -K::radius(0);
            corners_[2 * a + 1] = a / 2 ? K::radius(1) : -K::radius(1);
        }
    }

    Problem problem(const double* b) const {
        Problem found;
        found.k = k_;
        found.m = m_;
        found.r = rows_;
        found.friction.d = K::D;
        found.friction.round = K::R;
        for (int j = 0; j < K::E; ++j) found.friction.radii[j] = K::radius(j);
        found.friction.facets = facets;
        found.friction.C = C_;
        found.friction.corners = K::R ? 0 : 4;
        found.friction.vertices = corners_;
        found.B = B_;
        found.b = b;
        found.lo = lo_;
        found.hi = hi_;
        found.R_lo = R_lo_;
        found.R_hi = R_hi_;
        found.P = P_;
        found.q = q_;
        return found;
    }

    // Row r of the torque rows: coefficient of component j of contact i.
    double& R(int r, int j, int i) { return B_[((m_ + r) * K::D + j) * k_ + i]; }

    template <class Unit>
    void lay_out(const Dual<K, double>& dual, const Unit& unit) {
        std::memset(B_ + m_ * K::D * k_, 0, sizeof(double) * rows_ * K::D * k_);
        for (int i = 0; i < k_; ++i) {
            const Block<K>& at = dual.blocks[i / width];
            const int lane = i % width;
            lo_[i] = in_lane(at.lo, lane);
            hi_[i] = max(in_lane(at.hi, lane), lo_[i] + 1e-9);
            for (int j = 0; j < K::D; ++j) {
                for (int r = 0; r < m_; ++r) B_[(r * K::D + j) * k_ + i] = in_lane(at.a[j][r], lane);
                for (int c = 0; c < K::D; ++c) P_[(j * K::D + c) * k_ + i] = j == c ? in_lane(at.w[j], lane) : 0.0;
                q_[j * k_ + i] = 0.0;
            }
        }
        for (const Link& link : links_)
            if (row_of_[link.joint] >= 0)
                for (int j = 0; j < K::D; ++j) R(row_of_[link.joint], j, link.contact) += torque(link, j, unit);
        if (couplings_) add_couplings(unit);
    }

    // Torque of a link's joint by a unit of component j.
    template <class Unit>
    double torque(const Link& link, int j, const Unit& unit) const {
        const int i = link.contact, c = j == K::E ? 2 : j;
        const double *J = inputs.jacobian + 6 * link.column, *turn = inputs.rotations + 9 * i;
        const double size = unit(j, i);
        if (j == 2 && K::D == 4)  // a moment about the normal
            return size * (J[3] * turn[2] + J[4] * turn[5] + J[5] * turn[8]);
        const double u = size * turn[c], v = size * turn[3 + c], z = size * turn[6 + c];
        double p[3];
        place(i, p);
        return J[0] * u + J[1] * v + J[2] * z + J[3] * (p[1] * z - p[2] * v) + J[4] * (p[2] * u - p[0] * z) +
               J[5] * (p[0] * v - p[1] * u);
    }

    void place(int i, double* p) const {
        for (int c = 0; c < 3; ++c) p[c] = inputs.points[3 * i + c] + inputs.com[c];
    }

    // Rows of the couplings: less what friction bears, and with it.
    template <class Unit>
    void add_couplings(const Unit& unit) {
        std::memset(every_, 0, sizeof(double) * n_ * K::D * k_);
        for (const Link& link : links_)
            for (int j = 0; j < K::D; ++j) every_[(link.joint * K::D + j) * k_ + link.contact] += torque(link, j, unit);
        for (int c = 0; c < couplings_; ++c) {
            const int low = low_of_[c];
            if (low < 0) continue;
            const double* E = coupling_rows_.data() + c * n_;
            for (int i = 0; i < k_; ++i) {
                for (int j = 0; j < K::D; ++j) {
                    double own = 0.0;
                    for (int joint = 0; joint < n_; ++joint) own += E[joint] * every_[(joint * K::D + j) * k_ + i];
                    R(low, j, i) = R(low + 1, j, i) = own;
                }
                const double arm = inputs.borne * lever(E, i);
                R(low, K::E, i) -= arm;
                R(low + 1, K::E, i) += arm;
            }
        }
    }

    // The most that a unit force at contact i makes of a coupling.
    double lever(const double* E, int i) const {
        double arm[3] = {}, p[3];
        place(i, p);
        for (const Link& link : links_) {
            if (link.contact != i) continue;
            const double share = E[link.joint], *J = inputs.jacobian + 6 * link.column;
            arm[0] += share * (J[0] + J[4] * p[2] - J[5] * p[1]);
            arm[1] += share * (J[1] + J[5] * p[0] - J[3] * p[2]);
            arm[2] += share * (J[2] + J[3] * p[1] - J[4] * p[0]);
        }
        return std::sqrt(arm[0] * arm[0] + arm[1] * arm[1] + arm[2] * arm[2]);
    }

    // Brings a torque row to length one; what it was.
    double to_unit(int r) {
        double *row = &R(r, 0, 0), square = 0.0;
        for (int l = 0; l < K::D * k_; ++l) square += row[l] * row[l];
        const double size = max(std::sqrt(square), 1e-12);
        for (int l = 0; l < K::D * k_; ++l) row[l] /= size;
        return size;
    }

    // More than any forces make of a torque row.
    double reach_of(int r) {
        double reach = 1.0;
        for (int i = 0; i < k_; ++i)
            for (int j = 0; j < K::D; ++j) reach += 2.0 * std::fabs(R(r, j, i)) * hi_[i];
        return reach;
    }

    // |gravity + J'f| <= limit over `scale`, and either side of the couplings.
    void set_ranges(double scale) {
        for (int j = 0; j < n_; ++j) {
            const int r = row_of_[j];
            if (r < 0) continue;
            const double size = to_unit(r) * scale;
            // A limit that no forces reach, or none at all, is as good as one just out of their reach.
            const double limit = min(inputs.limit[j], std::fabs(inputs.gravity[j]) + reach_of(r) * size);
            R_lo_[r] = (-limit - inputs.gravity[j]) / size;
            R_hi_[r] = (limit - inputs.gravity[j]) / size;
        }
        for (int c = 0; c < couplings_; ++c) {
            if (low_of_[c] < 0) continue;
            double value = inputs.coupled[c];
            for (int j = 0; j < n_; ++j) value -= coupling_rows_[c * n_ + j] * inputs.gravity[j];
            for (int side = 0; side < 2; ++side) {
                const int r = low_of_[c] + side;
                const double bound = value / (to_unit(r) * scale);
                const double reach = reach_of(r) + std::fabs(bound);
                const bool held = stops_.empty() || stops_[c] != (side == 0 ? 1 : -1);
                R_lo_[r] = side == 1 && held ? bound - trace : bound - reach;
                R_hi_[r] = side == 0 && held ? bound + trace : bound + reach;
            }
        }
    }

    // The forces that leave the least of the balance within the torque limits: infeasible where that is proven, stalled
    // where it is not, converged where there are none at all. Proximal passes, as in `closest`.
    Code closest_within(const Problem& problem, Dual<K, double>& dual, int& steps) {
        double give = 1e-3, nearest = infinity;
        bool sure = false;
        for (int pass = 0; pass < 10 && !sure; ++pass) {
            int used = 0;
            const Code done = interior_.solve(problem, give, x_, y_, used);
            steps += used;
            if (done != Code::converged || not_finite(x_, K::D * k_)) {
                if (nearest == infinity) break;
                // Too stiff: more softly again, about the nearest forces.
                give *= 4.0;
                continue;
            }
            const double off = missed(problem);
            if (off < nearest) {
                nearest = off;
                std::memcpy(best_, x_, sizeof(double) * K::D * k_);
            }
            double square = 0.0;
            for (int r = 0; r < m_; ++r) square += y_[r] * y_[r];
            const double size = max(std::sqrt(square), 1e-300);
            for (int r = 0; r < m_ + rows_; ++r) y_[r] /= size;
            sure = nearest - excluded(problem, y_) <= close_enough * max(nearest, 1.0);
            give = max(give * 0.1, 1e-7);
            for (int i = 0; i < k_; ++i)
                for (int j = 0; j < K::D; ++j)
                    q_[j * k_ + i] = -in_lane(dual.blocks[i / width].w[j], i % width) * x_[j * k_ + i];
        }
        if (nearest == infinity) return Code::converged;
        std::memcpy(x_, best_, sizeof(double) * K::D * k_);
        return sure ? Code::infeasible : Code::stalled;
    }

    double missed(const Problem& problem) const {
        double square = 0.0;
        for (int r = 0; r < m_; ++r) {
            double total = -problem.b[r];
            for (int l = 0; l < K::D * k_; ++l) total += B_[r * K::D * k_ + l] * x_[l];
            square += total * total;
        }
        return std::sqrt(square);
    }

    // The dual's forces, what rounding has outside of the cones and bounds brought back.
    void into_cones(Dual<K, double>& dual) const {
        for (int i = 0; i < k_; ++i) {
            Block<K>& at = dual.blocks[i / width];
            const int lane = i % width;
            const double F = min(max(x_[K::E * k_ + i], in_lane(at.lo, lane)), in_lane(at.hi, lane));
            double square = 0.0;
            for (int j = 0; j < K::R; ++j) square += x_[j * k_ + i] * x_[j * k_ + i];
            const double shrink = min(1.0, F / max(std::sqrt(square), 1e-300));
            for (int j = 0; j < K::E; ++j) {
                const double own = x_[j * k_ + i], most = K::radius(j) * F;
                in_lane(at.x[j], lane) = j < K::R ? own * shrink : min(max(own, -most), most);
            }
            in_lane(at.x[K::E], lane) = F;
        }
    }
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
