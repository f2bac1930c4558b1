// Forces that hold a changing load, tick by tick: all memory is taken when the loop is set up.
//
// Every tick minimises the sum of squares of normal and tangential forces (a torsional moment counts as the tangential
// force that uses as much friction) under balance, friction and the limits of F_n, from the last tick's multipliers.
// What cannot be balanced leaves the least that any forces within the limits leave. Where a joint would bear more than
// its limit, or where fewer drives than joints make the torques, interior points solve the tick, with rows for the
// joints.
#pragma once

#include <algorithm>
#include <cstring>
#include <memory>
#include <vector>

#include "columns.hpp"
#include "newton.hpp"
#include "torques.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

enum class Tick : int { converged = 0, stalled = 1, infeasible = 2, unusable = -1 };

// What a loop is set up with.
struct OnlineSetup {
    int contacts = 0;
    int components = 3, round = 2;  // of a force, and those of them in a cone
    bool moments = true;            // whether they are to be balanced, too
    double torsion = 0.0;           // [m]
    double arm = 1.0;               // moments are divided by it [m]
    double safety = 1.0;            // friction is divided by it
    double ramp = 1.0;              // change of a contact's share in a tick
    double most_rate = infinity;    // largest change of F_n in a tick but the first [N]
    int most_steps = 50;            // Newton steps of one try
    int joints = 0;
    std::vector<Link> links;            // by contact: which joints move it
    std::vector<int> limited;           // joints with a torque limit
    int couplings = 0;                  // combinations of the torques that no drive makes
    std::vector<double> coupling_rows;  // (couplings, joints)
    std::vector<double> coupled;        // what springs make of them (couplings)
    std::vector<int> stops;             // 1: a joint at its end lets it be more, -1: less, 0: neither; none: 0 each
    double borne = 0.0;                 // share of the contacts' torques on them that friction bears
};

// What no loop can be set up with: the name of the first such field; none (nullptr) where all can be used.
inline const char* fault_of(const OnlineSetup& setup) {
    // Lengths, shares and factors of usual sizes: computations neither overflow nor lose all digits.
    const auto positive = [](double one) { return one >= 1e-9 && one <= 1e9; };
    const auto is_joint = [&](int one) { return one >= 0 && one < setup.joints; };
    if (setup.contacts < 1 || setup.contacts > most_contacts) return "contacts";
    if (!has_shape(setup.components, setup.round)) return "components, round";
    if (!(setup.torsion == 0.0 || positive(setup.torsion))) return "torsion";
    if (!positive(setup.arm)) return "arm";
    if (!positive(setup.safety)) return "safety";
    if (!(setup.ramp > 0.0 && setup.ramp <= 1.0)) return "ramp";
    if (!(setup.most_rate >= 0.0)) return "most_rate";
    if (setup.most_steps < 1 || setup.most_steps > 10000) return "most_steps";
    if (setup.joints < 0 || setup.joints > most_contacts) return "joints";
    int contact = 0;  // links are in the order of the contacts
    for (const Link& link : setup.links) {
        if (link.contact < contact || link.contact >= setup.contacts || link.column < 0 ||
            link.column > most_contacts || !is_joint(link.joint))
            return "links";
        contact = link.contact;
    }
    std::vector<bool> has_limit(setup.joints, false);
    for (int joint : setup.limited) {
        if (!is_joint(joint) || has_limit[joint]) return "limited";
        has_limit[joint] = true;
    }
    const std::size_t rows = setup.coupled.size();
    if (setup.couplings < 0 || rows != static_cast<std::size_t>(setup.couplings) ||
        not_finite(setup.coupled.data(), rows))
        return "coupled";
    if (!setup.stops.empty() && setup.stops.size() != rows) return "stops";
    const std::size_t entries = setup.coupling_rows.size();
    if (entries != rows * setup.joints || not_finite(setup.coupling_rows.data(), entries)) return "coupling_rows";
    if (!(setup.borne >= 0.0 && setup.borne <= 1.0)) return "borne";
    return nullptr;
}

// A loop. Inputs stay as they are until they are written again; outputs are of the last tick.
class Online {
public:
    virtual ~Online() = default;

    // Inputs.
    double wrench[6] = {};                        // the load, about the centre of mass, linear first [N, N m]
    double com[3] = {};                           // centre of mass [m]
    double* points = nullptr;                     // of the contacts, about the centre of mass (k, 3) [m]
    double* rotations = nullptr;                  // contact frames (k, 3, 3), z the inward normal
    double* mu = nullptr;                         // friction coefficients (k)
    double *least = nullptr, *largest = nullptr;  // F_n (k) [N]
    double *share = nullptr, *target = nullptr;   // of these that holds now, and what it moves to (k)
    double* torque_limit = nullptr;               // of the joints (n)
    const double* jacobian =
        nullptr;                      // (6, columns), column by column: world axes, linear velocity at the origin first
    const double* gravity = nullptr;  // torques that gravity needs (n)
    bool moved = true;                // points, rotations or mu have changed since the last tick

    // Outputs.
    double* forces = nullptr;       // (k, 3) in the contacts' axes [N]
    double* moments = nullptr;      // about the normals (k) [N m]
    double unbalanced[6] = {};      // what forces and load leave over [N, N m]
    double* torques = nullptr;      // (n) [N m]
    double* multipliers = nullptr;  // of the balance (6) [N]
    double off = 0.0;               // norm of what is not balanced, moments over the arm [N]
    int steps = 0;                  // Newton steps

    // The forces for the inputs. Converged: balanced; infeasible: the closest forces; stalled: the closest that were
    // found within the steps; unusable, and nothing has changed: an input is missing or not finite, a limit or a
    // friction coefficient is negative, or a share is not from zero to one.
    Tick tick() {
        const Tick found = solve_tick(started ? setup_.most_rate : infinity);
        started = started || found != Tick::unusable;
        return found;
    }

    // A contact is gained or lost at the ramp's rate: gained, its limits rise from nothing; lost, its force falls from
    // what it is, and no faster than most_rate. At once: without either, as it is before the first tick.
    void engage(int contact, bool touches = true, bool at_once = false) {
        target[contact] = touches ? 1.0 : 0.0;
        if (started && !at_once) return;
        share[contact] = target[contact];
        fading_[contact] = infinity;
    }

    // Forget the last tick: the next one starts cold, and its forces at any rate.
    void reset() {
        started = false;
        std::fill_n(multipliers, 6, 0.0);
        std::fill_n(fading_, setup_.contacts, infinity);
    }

    bool started = false;  // there was a tick
    const OnlineSetup& setup() const { return setup_; }

protected:
    virtual Tick solve_tick(double rate) = 0;

    explicit Online(OnlineSetup setup) : setup_(std::move(setup)) {
        const int k = setup_.contacts, n = setup_.joints;
        for (double** part : {&mu, &least, &largest, &share, &target, &moments, &fading_})
            *part = memory_.part<double>(k);
        points = memory_.part<double>(3 * k);
        rotations = memory_.part<double>(9 * k);
        forces = memory_.part<double>(3 * k);
        torque_limit = memory_.part<double>(n);
        torques = memory_.part<double>(n);
        multipliers = memory_.part<double>(6);
        std::fill_n(share, k, 1.0);
        std::fill_n(target, k, 1.0);
        std::fill_n(fading_, k, infinity);
        std::fill_n(torque_limit, n, infinity);
    }

    // The largest F_n of a contact in this tick, its share moved on.
    double cap(int i, double rate) {
        const double F = started ? forces[3 * i + 2] : 0.0;
        if (target[i] >= 1.0 && fading_[i] < infinity) {  // on its way out, and back: from the force that it has
            if (largest[i] > 0.0) share[i] = min(share[i], F / largest[i]);
            fading_[i] = infinity;
        } else if (target[i] < share[i] && fading_[i] == infinity) {
            fading_[i] = F / share[i];
        }
        share[i] += min(max(target[i] - share[i], -setup_.ramp), setup_.ramp);
        const double high = share[i] * min(largest[i], fading_[i]);
        const bool falls = fading_[i] < infinity && setup_.ramp < 1.0;
        return falls ? min(largest[i], max(high, F - rate)) : high;
    }

    OnlineSetup setup_;
    double* fading_ = nullptr;  // F_n over its share as it was when a contact began to fade (k); infinity: it does not

private:
    Memory memory_;
};

template <class K>
class OnlineOf final : public Online {
public:
    explicit OnlineOf(const OnlineSetup& setup) : Online(setup), blocks_(blocks_of(setup.contacts)) {
        dual_.blocks = room_.part<Block<K>>(blocks_);
        dual_.count = blocks_;
        best_ = room_.part<Vector>(blocks_ * K::D);
        for (int i = 0; i < blocks_; ++i) {
            dual_.blocks[i].blank();
            dual_.blocks[i].weigh();
        }
        if (!setup.limited.empty() || setup.couplings > 0)
            within_ =
                std::make_unique<TorqueLimits<K>>(setup.contacts, setup.moments ? 6 : 3, setup.joints, setup.links,
                                                  setup.limited, setup.couplings, setup.coupling_rows, setup.stops);
    }

    Tick solve_tick(double rate) override {
        if (unusable()) return Tick::unusable;
        const double scale = set_up(rate);
        Code code = solve(scale);
        write(scale);
        if (within_ != nullptr && beyond()) code = within(scale);
        off = judge(dual_.blocks, blocks_, dual_.b).balance * scale;
        return static_cast<Tick>(code);
    }

private:
    int blocks_;
    Memory room_;
    Dual<K, double> dual_;
    Vector* best_;
    std::unique_ptr<TorqueLimits<K>> within_;

    // Moments over it vanish where they do not count.
    double arm() const { return setup_.moments ? setup_.arm : infinity; }
    double slip(int i) const { return mu[i] / setup_.safety; }

    static bool is_share(double one) { return one >= 0.0 && one <= 1.0; }

    bool unusable() const {
        const int k = setup_.contacts;
        bool usable = (gravity != nullptr || setup_.joints == 0) && (jacobian != nullptr || setup_.links.empty()) &&
                      !not_finite(wrench, 6) && !not_finite(com, 3) && !not_finite(least, k) &&
                      !not_finite(largest, k) && !not_finite(share, k) && !not_finite(target, k) &&
                      (gravity == nullptr || !not_finite(gravity, setup_.joints));
        for (int i = 0; i < k; ++i)
            usable &= least[i] >= 0.0 && largest[i] >= 0.0 && is_share(share[i]) && is_share(target[i]);
        for (int j : setup_.limited) usable &= torque_limit[j] >= 0.0;
        for (const Link& link : setup_.links) usable &= !not_finite(jacobian + 6 * link.column, 6);
        if (!moved || !usable) return !usable;
        for (int i = 0; i < k; ++i) usable &= mu[i] >= 0.0;
        return !usable || not_finite(points, 3 * k) || not_finite(rotations, 9 * k) || not_finite(mu, k);
    }

    // The tick's problem; returns what forces [N] are divided by.
    double set_up(double rate) {
        double scale = 1e-9;
        for (int r = 0; r < K::M; ++r) {
            dual_.b[r] = r < 3 ? -wrench[r] : -wrench[r] / arm();
            scale = max(scale, std::fabs(dual_.b[r]));
        }
        if (moved) place();
        for (int i = 0; i < setup_.contacts; ++i) {
            // Contacts are gained and lost gradually, and no force changes by more than its limit per tick.
            const double high = cap(i, rate), low = min(least[i] * share[i], high), F = forces[3 * i + 2];
            Block<K>& at = dual_.blocks[i / width];
            double& lo = in_lane(at.lo, i % width);
            lo = min(max(F - rate, low), high);
            in_lane(at.hi, i % width) = max(min(F + rate, high), lo);
            scale = max(scale, lo);
        }
        const double inverse = 1.0 / scale;
        for (int i = 0; i < blocks_; ++i) {
            Block<K>& at = dual_.blocks[i];
            at.lo = at.lo * Vector(inverse);
            at.hi = at.hi * Vector(inverse);
            for (Vector& one : at.q) one = 0.0;
        }
        for (double& one : dual_.b) one *= inverse;
        return scale;
    }

    // Columns of the balance and weights, after a change of points, frames or friction.
    void place() {
        for (int i = 0; i < setup_.contacts; ++i) {
            Block<K>& at = dual_.blocks[i / width];
            const int lane = i % width;
            const double friction = slip(i);
            set_columns(at, lane, points + 3 * i, rotations + 9 * i, friction, setup_.torsion / setup_.safety, arm());
            // Without friction the tangential components are zero: any weight will do.
            for (int j = 0; j < K::E; ++j) in_lane(at.w[j], lane) = max(friction * friction, 1e-6);
            in_lane(at.w[K::E], lane) = 1.0;
        }
        for (int i = 0; i < blocks_; ++i) dual_.blocks[i].weigh();
        moved = false;
    }

    // Forces from the last tick's multipliers, and where these do not lead there from zero; the closest forces where
    // none balance the load.
    Code solve(double scale) {
        using N = Newton<K, double>;
        steps = 0;
        for (int r = 0; r < K::M; ++r) dual_.y[r] = multipliers[r] / scale;
        Code code = ascend(dual_, N::balanced, setup_.most_steps, steps);
        if (code == Code::stalled) {
            for (double& one : dual_.y) one = 0.0;
            code = ascend(dual_, N::balanced, setup_.most_steps, steps);
        }
        for (int r = 0; r < K::M; ++r) multipliers[r] = code == Code::converged ? dual_.y[r] * scale : 0.0;
        if (code == Code::converged) return code;
        return closest(dual_, best_, setup_.most_steps, steps);
    }

    // Outputs from the solution.
    void write(double scale) {
        std::memcpy(unbalanced, wrench, sizeof unbalanced);
        for (int j = 0; j < setup_.joints; ++j) torques[j] = gravity[j];
        auto link = setup_.links.cbegin();
        for (int i = 0; i < setup_.contacts; ++i) {
            const Block<K>& at = dual_.blocks[i / width];
            const int lane = i % width;
            double* f = forces + 3 * i;
            for (int c = 0; c < 3; ++c) {
                const int j = c == 2 ? K::E : c;
                f[c] = in_lane(at.x[j], lane) * scale * unit_of<K>(j, slip(i), 0.0);
            }
            if constexpr (K::D == 4) moments[i] = in_lane(at.x[2], lane) * scale * setup_.torsion / setup_.safety;
            add_contact(i, link);
        }
    }

    // A contact's part of the balance and of the torques.
    void add_contact(int i, std::vector<Link>::const_iterator& link) {
        const double *R = rotations + 9 * i, *p = points + 3 * i, *f = forces + 3 * i;
        double world[3], turn[3], about[3];
        for (int c = 0; c < 3; ++c) {
            world[c] = R[3 * c] * f[0] + R[3 * c + 1] * f[1] + R[3 * c + 2] * f[2];
            turn[c] = R[3 * c + 2] * moments[i];
        }
        for (int c = 0; c < 3; ++c) {
            const int s = (c + 1) % 3, t = (c + 2) % 3;
            unbalanced[c] += world[c];
            unbalanced[3 + c] += turn[c] + p[s] * world[t] - p[t] * world[s];
            about[c] = turn[c] + (p[s] + com[s]) * world[t] - (p[t] + com[t]) * world[s];
        }
        for (; link != setup_.links.end() && link->contact == i; ++link) {
            const double* J = jacobian + 6 * link->column;
            for (int c = 0; c < 3; ++c) torques[link->joint] += J[c] * world[c] + J[3 + c] * about[c];
        }
    }

    bool beyond() const {
        bool found = setup_.couplings > 0;
        for (int j : setup_.limited) found |= std::fabs(torques[j]) > torque_limit[j];
        return found;
    }

    // The tick again, with rows for the joints.
    Code within(double scale) {
        within_->inputs = {points,      rotations, com, jacobian, gravity, torque_limit, setup_.coupled.data(),
                           setup_.borne};
        Code code = within_->solve(
            dual_, scale, [this](int j, int i) { return unit_of<K>(j, slip(i), setup_.torsion / setup_.safety); },
            steps);
        write(scale);
        for (int j : setup_.limited)
            if (code == Code::converged && std::fabs(torques[j]) > torque_limit[j] * (1.0 + 1e-7))
                code = Code::infeasible;
        return code;
    }
};

// A loop; none (nullptr) where the set-up has a fault, see `fault_of`.
inline std::unique_ptr<Online> make_online(const OnlineSetup& setup) {
    if (fault_of(setup) != nullptr) return nullptr;
    return of_shape(setup.components, setup.round, [&](auto shape) -> std::unique_ptr<Online> {
        return std::make_unique<OnlineOf<decltype(shape)>>(setup);
    });
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
