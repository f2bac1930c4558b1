// Many force problems at once: one in each lane, by the dual Newton method. Where a lane is done, the next problem
// takes its place.
#pragma once

#include "columns.hpp"
#include "memory.hpp"
#include "newton.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// N problems of up to k contacts, of which the first `counts` (N) count; t powers of F_n in the objective.
struct Batch {
    int k = 0, t = 0;
    bool moments = true;                  // whether they are to be balanced, too
    double torsion = 0.0, squares = 0.0;  // [m] over the safety factor; weight of the sum of squared forces
    const double* points = nullptr;       // about the centres of mass (N, k, 3)
    const double* rotations = nullptr;    // contact frames (N, k, 3, 3)
    const std::int64_t* counts = nullptr;
    const double* loads = nullptr;                 // (N, 6)
    const double* mu = nullptr;                    // over the safety factor (N, k)
    const double *low = nullptr, *high = nullptr;  // F_n (N, k)
    const double* arms = nullptr;                  // moment lengths (N)
    const double* terms = nullptr;                 // pairs (coefficient, exponent) (N, t, 2)
    // > 0: instead of forces the least friction is searched for, over the safety factor, up to that, and so exactly.
    double most_mu = 0.0, within = 0.0;
};

// Forces (N, k, 3), torsional moments (N, k); objective, lower bound, residual [N], violation [N], code (N). Of a
// search only the code, and the least friction that holds, from above, or infinity (N).
struct BatchResults {
    double *forces = nullptr, *moments = nullptr, *objective = nullptr, *lower_bound = nullptr, *residual = nullptr,
           *violation = nullptr;
    std::int64_t* codes = nullptr;
    double* least_mu = nullptr;
};

template <class K>
class BatchOf {
public:
    explicit BatchOf(const Batch& batch) : batch_(batch), k_(batch.k) {
        method_.dual.blocks = memory_.part<Block<K>>(k_);
        method_.dual.count = k_;
        method_.costs = memory_.part<Cost<K>>(k_);
        for (int lane = 0; lane < width; ++lane) leave(lane);
    }

    // Problems `start` to `stop`.
    void solve(std::int64_t start, std::int64_t stop, const BatchResults& results) {
        next_ = start;
        stop_ = stop;
        results_ = results;
        for (int lane = 0; lane < width; ++lane) take(lane);
        begin(busy());
        while (any(busy())) {
            const Vector size = method_.dual.residual();
            const Mask there = busy() & (size <= tolerance_);
            if (any(there)) {
                settle(there);
                continue;
            }
            const auto step = method_.dual.step(busy(), busy() & doubtful());
            ascents_ = ascents_ + Vector(1.0);
            const Mask late = busy() & (ascents_ > Vector(N::most_steps - 0.5));
            end(step.infeasible, Code::infeasible);
            end((step.stalled | late) & !step.infeasible, Code::stalled);
        }
    }

private:
    using N = Newton<K, Vector>;

    // Of the most friction, what a search tries first; of friction that is enough, the next as long as nothing less is
    // proven to be too little: many grasps need next to none.
    static constexpr double first_share = 0.25, first_step = 0.125;
    static constexpr int most_doubts = 3;

    Batch batch_;
    int k_;
    Memory memory_;
    N method_;
    BatchResults results_;
    std::int64_t next_ = 0, stop_ = 0, at_[width];
    Vector active_ = 0.0;                 // 1: the lane has a problem
    Vector weight_, tolerance_, strong_;  // of the pass; 1: no proximal weight is needed
    Vector ascents_ = 0.0;
    int passes_[width] = {};
    double scale_[width], unit_[width];
    // Of a search: friction that is too little, enough, and tried; multipliers of the last forces.
    double low_[width], high_[width], tried_[width], held_[width][K::M];
    int doubts_[width] = {};

    bool searches() const { return batch_.most_mu > 0.0; }
    double mu(std::int64_t at, int lane) const { return searches() ? tried_[lane] : batch_.mu[at]; }

    Mask busy() const { return active_ > Vector(0.5); }

    // Every eighth step of a lane.
    Mask doubtful() const {
        Vector found = 0.0;
        for (int lane = 0; lane < width; ++lane)
            in_lane(found, lane) = static_cast<int>(in_lane(ascents_, lane)) % 8 == 7;
        return found > Vector(0.5);
    }

    // A lane without a problem: contacts that do not count.
    void leave(int lane) {
        in_lane(active_, lane) = 0.0;
        at_[lane] = -1;
        for (int i = 0; i < k_; ++i) empty(i, lane);
        for (int r = 0; r < K::M; ++r) {
            in_lane(method_.dual.b[r], lane) = 0.0;
            in_lane(method_.dual.y[r], lane) = 0.0;
        }
        for (int a = 0; a < most_powers; ++a) {
            in_lane(method_.coefficients[a], lane) = 0.0;
            in_lane(method_.exponents[a], lane) = 0.0;
        }
        in_lane(tolerance_, lane) = 1.0;
        in_lane(weight_, lane) = 0.0;
        in_lane(strong_, lane) = 1.0;
    }

    void empty(int i, int lane) {
        Block<K>& at = method_.dual.blocks[i];
        for (int j = 0; j < K::D; ++j) {
            for (int r = 0; r < K::M; ++r) in_lane(at.a[j][r], lane) = 0.0;
            in_lane(at.w[j], lane) = in_lane(method_.costs[i].P[j], lane) = 1.0;
            in_lane(at.q[j], lane) = in_lane(method_.costs[i].q[j], lane) = 0.0;
            in_lane(at.x[j], lane) = in_lane(at.s[j], lane) = in_lane(at.v[j], lane) = 0.0;
        }
        in_lane(at.lo, lane) = in_lane(at.hi, lane) = 0.0;
    }

    // The next problem that can be solved, in a lane.
    void take(int lane) {
        while (next_ < stop_) {
            const std::int64_t p = next_++;
            low_[lane] = 0.0;
            high_[lane] = infinity;
            doubts_[lane] = 0;
            tried_[lane] = first_share * batch_.most_mu;
            const Code code = load(p, lane);
            if (code == Code::converged) {
                at_[lane] = p;
                in_lane(active_, lane) = 1.0;
                return;
            }
            results_.codes[p] = static_cast<std::int64_t>(code);
        }
        leave(lane);
    }

    // Problem p in a lane; infeasible: its limits exclude each other.
    Code load(std::int64_t p, int lane) {
        const double *wrench = batch_.loads + 6 * p, arm = batch_.arms[p], reach = batch_.moments ? arm : infinity,
                     *low = batch_.low + p * k_, *high = batch_.high + p * k_;
        const int count = static_cast<int>(batch_.counts[p]);
        double b[K::M], scale = 0.0;
        for (int r = 0; r < K::M; ++r) {
            b[r] = r < 3 ? -wrench[r] : -wrench[r] / reach;
            scale += b[r] * b[r];
        }
        scale = std::sqrt(scale);
        if (scale == 0.0) scale = low[0] > 0.0 ? low[0] : 1.0;
        for (int i = 0; i < count; ++i)
            if (!(low[i] <= high[i])) return Code::infeasible;
        double heaviest = 0.0, lightest = infinity;
        for (int i = 0; i < count; ++i)
            for (int j = 0; j < K::D; ++j) {
                const double own = weight(j, mu(p * k_ + i, lane), arm);
                heaviest = max(heaviest, own);
                lightest = min(lightest, own);
            }
        // Searches are for forces of least squares over their limits.
        double unit = searches() ? scale * scale : 0.5 * heaviest * scale * scale;
        const double* terms = batch_.terms + 2 * p * batch_.t;
        for (int a = 0; a < batch_.t; ++a) unit = max(unit, terms[2 * a] * std::pow(scale, terms[2 * a + 1]));
        Powers powers;
        if (!(unit > 0.0) || !powers_of(terms, batch_.t, scale, unit, powers)) return Code::stalled;
        for (int r = 0; r < K::M; ++r) {
            in_lane(method_.dual.b[r], lane) = b[r] / scale;
            in_lane(method_.dual.y[r], lane) = 0.0;
        }
        for (int a = 0; a < most_powers; ++a) {
            in_lane(method_.coefficients[a], lane) = powers.coefficients[a];
            in_lane(method_.exponents[a], lane) = powers.exponents[a];
        }
        method_.powers = powers.count > method_.powers ? powers.count : method_.powers;
        const double curvature = scale * scale / unit;
        for (int i = 0; i < k_; ++i) {
            if (i < count)
                place(p, i, lane, count, scale, curvature);
            else
                empty(i, lane);
        }
        scale_[lane] = scale;
        unit_[lane] = unit;
        const bool strong = lightest * curvature >= N::strong;
        in_lane(strong_, lane) = strong;
        start(lane, strong ? 0.0 : N::first_weight);
        passes_[lane] = 0;
        return Code::converged;
    }

    double weight(int j, double mu, double arm) const {
        if (searches()) return 1.0;
        const double size = unit_of<K>(j, mu, batch_.torsion / arm);
        return 2.0 * batch_.squares * size * size;
    }

    void place(std::int64_t p, int i, int lane, int count, double scale, double curvature) {
        const std::int64_t at = p * k_ + i;
        Block<K>& block = method_.dual.blocks[i];
        set_columns(block, lane, batch_.points + 3 * at, batch_.rotations + 9 * at, mu(at, lane), batch_.torsion,
                    batch_.moments ? batch_.arms[p] : infinity);
        const double lo = batch_.low[at] / scale, hi = batch_.high[at] / scale;
        in_lane(block.lo, lane) = lo;
        in_lane(block.hi, lane) = hi;
        for (int j = 0; j < K::D; ++j) {
            in_lane(method_.costs[i].P[j], lane) = weight(j, mu(at, lane), batch_.arms[p]) * curvature;
            in_lane(method_.costs[i].q[j], lane) = 0.0;
            in_lane(block.x[j], lane) = j < K::E ? 0.0 : min(max(2.0 / count, lo), hi);
        }
    }

    // A pass of a lane.
    void start(int lane, double weight) {
        in_lane(weight_, lane) = weight;
        in_lane(tolerance_, lane) = weight < 2.0 * N::least_weight ? N::balanced : N::roughly;
        in_lane(ascents_, lane) = 0.0;
    }

    void begin(Mask which) {
        method_.model(which, weight_);
        method_.dual.begin(which);
    }

    // Lanes whose balance holds: their next pass, or the end.
    void settle(Mask there) {
        const Gap<Vector> gap = method_.gap();
        const Misses<Vector> misses = judge(method_.dual.blocks, k_, method_.dual.b);
        const Mask once = there & (strong_ > Vector(0.5)) & (Vector(method_.powers) < Vector(0.5));
        const Mask last = weight_ < Vector(2.0 * N::least_weight);
        const Mask closed = gap.value - gap.bound <= Vector(N::closed) * max(abs(gap.value), Vector(1e-12));
        const Mask done = once | (there & last & closed);
        for (int lane = 0; lane < width; ++lane) {
            if (!lane_of(there, lane)) continue;
            if (lane_of(done, lane)) {
                follow(lane, finish(lane, in_lane(gap.value, lane), in_lane(gap.bound, lane),
                                    {in_lane(misses.balance, lane), in_lane(misses.violation, lane)}));
            } else if (++passes_[lane] >= N::passes) {
                follow(lane, Code::stalled);
            } else {
                const double weight = max(in_lane(weight_, lane) * N::shrink, N::floor);
                start(lane, in_lane(strong_, lane) > 0.5 ? 0.0 : weight);
            }
        }
        begin(there);
    }

    // Lanes without an answer.
    void end(Mask which, Code code) {
        which = which & busy();
        if (!any(which)) return;
        for (int lane = 0; lane < width; ++lane)
            if (lane_of(which, lane)) follow(lane, code);
        begin(which);
    }

    // The next problem after one that ended so.
    void follow(int lane, Code code) {
        if (searches()) {
            if (narrows(lane, code)) return;
            if (code == Code::infeasible) code = Code::converged;
        }
        results_.codes[at_[lane]] = static_cast<std::int64_t>(code);
        take(lane);
    }

    // Whether a search goes on after friction that is enough or not: with the same problem and other friction.
    bool narrows(int lane, Code code) {
        const std::int64_t p = at_[lane];
        if (code == Code::stalled) {
            // Too near to the least friction to tell: then more of it is tried, a few times.
            if (!std::isfinite(high_[lane]) || ++doubts_[lane] > most_doubts) return false;
            try_friction(lane, 0.5 * (tried_[lane] + high_[lane]));
            return true;
        }
        if (code == Code::converged) {
            high_[lane] = tried_[lane];
            for (int r = 0; r < K::M; ++r) held_[lane][r] = in_lane(method_.dual.y[r], lane);
        } else {
            low_[lane] = tried_[lane];
        }
        if (low_[lane] >= batch_.most_mu || high_[lane] - low_[lane] <= batch_.within) {
            results_.least_mu[p] = high_[lane];
            return false;
        }
        if (!std::isfinite(high_[lane]))
            try_friction(lane, batch_.most_mu);
        else
            try_friction(lane, low_[lane] > 0.0 ? 0.5 * (low_[lane] + high_[lane]) : first_step * high_[lane]);
        return true;
    }

    // The problem of a lane anew, with other friction, from the multipliers of what was enough.
    void try_friction(int lane, double mu) {
        tried_[lane] = mu;
        load(at_[lane], lane);
        for (int r = 0; r < K::M && std::isfinite(high_[lane]); ++r) in_lane(method_.dual.y[r], lane) = held_[lane][r];
    }

    // The answer of a lane, checked.
    Code finish(int lane, double value, double bound, const Misses<double>& misses) {
        const std::int64_t p = at_[lane];
        const double scale = scale_[lane], unit = unit_[lane];
        if (searches()) return misses.balance <= 1e-10 && misses.violation <= 1e-10 ? Code::converged : Code::stalled;
        // A bound from multipliers that are exact to rounding can exceed the value by rounding.
        results_.objective[p] = value * unit;
        results_.lower_bound[p] = min(bound, value) * unit;
        results_.residual[p] = misses.balance * scale;
        results_.violation[p] = max(misses.violation, 0.0) * scale;
        // Negated, so that what is no number fails.
        const bool fine = std::isfinite(results_.objective[p]) && std::isfinite(results_.lower_bound[p]) &&
                          misses.balance <= 1e-10 && misses.violation <= 1e-10 &&
                          value - bound <= 1e-8 * max(std::fabs(value), 1e-5);
        if (!fine) return Code::stalled;
        for (int i = 0; i < batch_.counts[p]; ++i) {
            const Block<K>& at = method_.dual.blocks[i];
            double* f = results_.forces + 3 * (p * k_ + i);
            const double mu = batch_.mu[p * k_ + i];
            f[0] = in_lane(at.x[0], lane) * scale * mu;
            f[1] = in_lane(at.x[1], lane) * scale * mu;
            f[2] = in_lane(at.x[K::E], lane) * scale;
            if constexpr (K::D == 4) results_.moments[p * k_ + i] = in_lane(at.x[2], lane) * scale * batch_.torsion;
        }
        return Code::converged;
    }
};

// Solve problems `start` to `stop` of a friction model; several threads may take a part each.
inline void solve_batch(const Batch& batch, int components, int round, std::int64_t start, std::int64_t stop,
                        const BatchResults& results) {
    of_shape(components, round, [&](auto shape) { BatchOf<decltype(shape)>(batch).solve(start, stop, results); });
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
