// A squeeze that follows what is felt: friction, load and slip are estimated tick by tick, the forces are those of
// `Online` for them. All memory is taken when it is set up.
//
// What is commanded are the planned forces and internal ones besides, so that a squeeze never pushes the object away by
// itself: f = f0 + P (f* - f0), with f* the forces of least squares for the load that is felt, in the cones of the
// friction that is believed over a margin, and never under a share of the planned squeeze. Whoever slips tells the
// friction of all that have not held with more; where most of the squeeze slips, all of it jumps at once, as it is
// planned, and is released slowly.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "online.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

enum class Feeling : int { forces = 0, normal_forces = 1, slips = 2, torques = 3, wrench = 4, acceleration = 5 };
constexpr int feelings = 6;

// What a grip is set up with, besides the loop of its forces.
struct GripSetup {
    double period = 1e-3;      // of the ticks [s]
    double latency = 0.0;      // of sensors and drives together [s]
    double smoothing = 0.015;  // of what is felt [s]
    double noise = 0.1;        // standard deviation of a felt force or torque, as a share of it
    double scale = 0.1;        // the same of what a joint makes of its torque, which lasts
    double margin = 1.25;      // friction is used up to mu over it
    double kept = 0.45;        // share of the planned squeeze that stays, in proportion to load over friction
    double unfelt = 1.5;       // the same where no load or no slip is felt
    double jump = 1.8;         // times the squeeze where most of it slips
    double calm = 0.25;        // without slip, before the squeeze is released [s]
    double release = 0.4;      // in which it falls to 1/e of what it was [s]
    double blind = 0.05;       // without any measurement, after which nothing is released [s]
    double gravity[3] = {0.0, 0.0, -9.81};  // [m/s^2]
    double load[6] = {};                    // as planned, about the centre of mass [N, N m]
    bool tells_load = false;                // whether the joints' torques tell forces with their tangential parts
    std::vector<double> planned;            // forces in contact axes (k, 3) [N]
    std::vector<double> grasp_map;          // (6, 3 k)
    std::vector<double> internal;           // projection on the internal forces (3 k, 3 k)
    std::vector<double> joint_map;          // torques by forces (n, 3 k)
    std::vector<double> from_torques;       // forces by torques (3 k, n)
    std::vector<double> bias;               // torques besides (n) [N m or N]
    std::vector<double> torque_limit;       // (n); infinity: none
    std::vector<double> most;               // F_n (k) [N]
    std::vector<double> mu;                 // as planned (k)
};

// What no grip can be set up with: the name of the first such field; none (nullptr) where all can be used.
inline const char* fault_of(const GripSetup& setup, const OnlineSetup& online) {
    const std::size_t k = online.contacts, n = setup.bias.size();
    const auto positive = [](double one) { return one > 0.0 && one <= 1e9; };
    // Of usual sizes, so that no product of them overflows.
    const auto usual = [](const double* values, std::size_t count) {
        return std::all_of(values, values + count, [](double one) { return std::fabs(one) <= 1e9; });
    };
    const auto fits = [&usual](const std::vector<double>& values, std::size_t count) {
        return values.size() == count && usual(values.data(), count);
    };
    if (!positive(setup.period)) return "period";
    if (!(setup.latency >= 0.0 && setup.latency <= 10.0)) return "latency";
    if (!positive(setup.smoothing)) return "smoothing";
    if (!(setup.noise >= 0.0 && setup.noise <= 10.0)) return "noise";
    if (!(setup.scale >= 0.0 && setup.scale <= 10.0)) return "scale";
    if (!(setup.margin >= 1.0 && setup.margin <= 1e3)) return "margin";
    if (!(setup.kept >= 0.0 && setup.kept <= 1e3)) return "kept";
    if (!(setup.unfelt >= 0.0 && setup.unfelt <= 1e3)) return "unfelt";
    if (!(setup.jump >= 1.0 && setup.jump <= 1e3)) return "jump";
    if (!(setup.calm >= 0.0)) return "calm";
    if (!positive(setup.release)) return "release";
    if (!(setup.blind >= 0.0)) return "blind";
    if (!usual(setup.gravity, 3)) return "gravity";
    if (!usual(setup.load, 6)) return "load";
    if (!fits(setup.planned, 3 * k)) return "planned";
    if (!fits(setup.grasp_map, 18 * k)) return "grasp_map";
    if (!fits(setup.internal, 9 * k * k)) return "internal";
    if (n > static_cast<std::size_t>(most_contacts)) return "bias";
    if (!fits(setup.bias, n)) return "bias";
    if (!fits(setup.joint_map, 3 * k * n)) return "joint_map";
    if (!fits(setup.from_torques, 3 * k * n)) return "from_torques";
    if (setup.torque_limit.size() != n) return "torque_limit";
    for (double one : setup.torque_limit)
        if (!(one >= 0.0)) return "torque_limit";
    if (!fits(setup.most, k)) return "most";
    if (!fits(setup.mu, k)) return "mu";
    for (std::size_t i = 0; i < k; ++i)
        if (!(setup.mu[i] >= 0.0)) return "mu";
    for (std::size_t i = 0; i < k; ++i)
        if (!(setup.most[i] >= 0.0 && setup.planned[3 * i + 2] <= setup.most[i] * (1.0 + 1e-6))) return "most";
    return nullptr;
}

class Grip {
public:
    // On a loop, which stays where it is, with points, frames, Jacobian and gravity set.
    Grip(Online& online, const GripSetup& setup)
        : online_(online), setup_(setup), k_(online.setup().contacts), n_(static_cast<int>(setup.bias.size())) {
        for (double** part : {&felt, &wanted, &forces, &more_, &lagging_, &work_, &variance_})
            *part = memory_.part<double>(3 * k_);
        for (double** part : {&since_, &given_, &mu_low, &mu_high, &mu, &slipping}) *part = memory_.part<double>(k_);
        for (double** part : {&torques, &measured_}) *part = memory_.part<double>(n_);
        pulls_ = memory_.part<double>(3 * n_);
        for (int r = 0; r < 3; ++r)
            for (int j = 0; j < n_; ++j)
                for (int c = 0; c < 3 * k_; ++c)
                    pulls_[r * n_ + j] -= setup.grasp_map[r * 3 * k_ + c] * setup.from_torques[c * n_ + j];
        holding_ = memory_.copy(setup.bias.data(), n_);
        for (int i = 0; i < k_; ++i)
            if (setup.planned[3 * i + 2] > 0.0) largest_ = min(largest_, setup.most[i] / setup.planned[3 * i + 2]);
        for (int j = 0; j < n_; ++j)
            for (int c = 0; c < 3 * k_; ++c) holding_[j] += setup.joint_map[j * 3 * k_ + c] * setup.planned[c];
        reset();
    }

    // Outputs of the last tick.
    double* forces = nullptr;    // commanded, in contact axes (k, 3) [N]
    double* torques = nullptr;   // (n) [N m or N]
    double* wanted = nullptr;    // for the load that is felt, of which internal parts are commanded (k, 3) [N]
    double* felt = nullptr;      // smoothed forces (k, 3) [N]
    double* mu = nullptr;        // friction that is believed (k)
    double* mu_low = nullptr;    // it is no less than that (k)
    double* mu_high = nullptr;   // nor more than that (k); infinity: nothing has slipped
    double* slipping = nullptr;  // 1: the contact slips (k)
    double load[6] = {};         // about the centre of mass [N, N m]
    double load_bound = 0.0;  // three standard deviations of its force, and how it has moved [N]; infinity: none felt
    double mass = 0.0;        // [kg]
    int reflexes = 0;         // so often the squeeze has jumped
    bool blind = false;       // nothing has been measured for a while: nothing is released

    int contacts() const { return k_; }
    int joints() const { return n_; }

    // How many numbers one kind of measurement has.
    int size_of(Feeling kind) const {
        switch (kind) {
            case Feeling::forces:
                return 3 * k_;
            case Feeling::normal_forces:
            case Feeling::slips:
                return k_;
            case Feeling::torques:
                return n_;
            case Feeling::wrench:
                return 6;
            case Feeling::acceleration:
                return 3;
        }
        return 0;
    }

    // Take in a measurement of a time [s]; false: it is nonsense, or not newer than the last one, and changes nothing.
    bool feel(Feeling kind, const double* values, double time) {
        const int size = size_of(kind), which = static_cast<int>(kind);
        if (!std::isfinite(time) || (std::isfinite(now_) && time > now_ + most_ahead) || !(time > stamps_[which]))
            return false;
        for (int i = 0; i < size; ++i)
            if (!(std::fabs(values[i]) < most_felt)) return false;
        const double apart = std::isfinite(stamps_[which]) ? time - stamps_[which] : infinity;
        const double share = 1.0 - std::exp(-apart / setup_.smoothing);
        stamps_[which] = time;
        heard_ = true;
        // Of the mean of what was felt, in those of one measurement.
        spreads_[which] = (1.0 - share) * (1.0 - share) * spreads_[which] + share * share;
        switch (kind) {
            case Feeling::forces:
                for (int i = 0; i < size; ++i) felt[i] += share * (values[i] - felt[i]);
                break;
            case Feeling::normal_forces:
                for (int i = 0; i < k_; ++i) felt[3 * i + 2] += share * (values[i] - felt[3 * i + 2]);
                break;
            case Feeling::slips:
                for (int i = 0; i < k_; ++i) {
                    slipping[i] = values[i] > 0.0 ? 1.0 : 0.0;
                    const double step = min(apart, longest);
                    since_[i] = slipping[i] > 0.0 ? since_[i] + step : max(0.0, since_[i] - 0.5 * step);
                }
                break;
            case Feeling::torques:
                feel_torques(values, share);
                break;
            case Feeling::wrench:
                for (int r = 0; r < 6; ++r) wrench_[r] += share * (-values[r] - wrench_[r]);
                break;
            case Feeling::acceleration:
                for (int c = 0; c < 3; ++c) acceleration_[c] += share * (values[c] - acceleration_[c]);
                break;
        }
        return true;
    }

    // Forces and torques for a time [s], which grows.
    Tick tick(double now) {
        if (!std::isfinite(now) || now < now_) return Tick::unusable;
        const double dt = std::isfinite(now_) ? min(now - now_, longest) : 0.0;
        now_ = now;
        if (!std::isfinite(begun_)) begun_ = now;
        // It counts when it came, however late sensors are, if it is not as old as what nothing is made of.
        const double newest = *std::max_element(stamps_, stamps_ + feelings);
        if (heard_ && now - newest <= setup_.blind + setup_.latency) fresh_ = now;
        heard_ = false;
        blind = now - max(fresh_, begun_) > setup_.blind;
        estimate(dt);
        learn_friction(dt);
        react();
        set_floor(dt);
        const Tick found = solve();
        follow(dt, found == Tick::converged);
        command();
        return found;
    }

    // Forget all that was felt.
    void reset() {
        std::copy_n(setup_.planned.data(), 3 * k_, felt);
        std::copy_n(setup_.planned.data(), 3 * k_, wanted);
        std::copy_n(setup_.planned.data(), 3 * k_, lagging_);
        std::fill_n(more_, 3 * k_, 0.0);
        for (int i = 0; i < k_; ++i) {
            since_[i] = slipping[i] = mu_low[i] = 0.0;
            mu_high[i] = given_[i] = infinity;
            mu[i] = setup_.mu[i];
        }
        floor_ = 1.0;
        level_ = 0.0;
        std::fill_n(stamps_, feelings, -infinity);
        std::fill_n(spreads_, feelings, 1.0);
        std::copy_n(setup_.load, 6, wrench_);
        std::copy_n(setup_.load, 3, steady_);
        std::copy_n(setup_.load, 6, load);
        std::copy_n(holding_, n_, measured_);
        moved_ = 0.0;
        std::fill_n(acceleration_, 3, 0.0);
        now_ = fresh_ = begun_ = -infinity;
        heard_ = false;
        slipped_ = jumped_ = -infinity;
        reflexes = 0;
        online_.reset();
        command();
    }

private:
    static constexpr double longest = 0.05;    // of a step in time that counts [s]
    static constexpr double most_ahead = 1.0;  // [s] that a measurement's clock may be ahead
    static constexpr double most_felt = 1e6;   // what is larger is nonsense
    static constexpr double sustained = 0.01;  // of slip that counts [s]
    static constexpr double settling = 0.3;    // after the beginning, before anything is released [s]
    static constexpr double firm = 0.3;        // [N] with less, a contact tells no friction
    static constexpr double relaxing = 0.2;    // of what is too much, in the time of the latencies
    static constexpr double most_less = 0.8;   // times the wanted forces: what is taken off a squeeze that is too hard
    static constexpr double rising = 1.1;      // times as much is wanted than before: then nothing is taken off
    static constexpr double dropping = 0.005;  // [s] in which that is given back
    static constexpr double learning = 0.02;   // of a slipping contact's friction [s]
    static constexpr double steady = 0.15;     // of the load that another one is told from [s]
    static constexpr double sure = 4.0;        // standard deviations of a ratio of which the largest counts
    static constexpr double tilted = 0.1;      // by which a normal may be another one than planned [rad]
    static constexpr double most_times = 4.0;  // the planned load over friction: more is no guide
    static constexpr double lightest = 0.4;    // of the planned load: less is not believed
    static constexpr double raising = 0.1;     // in which a squeeze as planned is added, but where it slips [s]

    Online& online_;
    GripSetup setup_;
    int k_, n_;
    Memory memory_;
    double* since_ = nullptr;    // how long contacts have slipped (k) [s]
    double* more_ = nullptr;     // internal forces that make up for what drives and servos do else (k, 3) [N]
    double* lagging_ = nullptr;  // wanted, as late as it is felt (k, 3) [N]
    double* given_ = nullptr;    // friction of contacts that slip (k)
    double* work_ = nullptr;
    double* variance_ = nullptr;  // of smoothed forces (k, 3) [N^2]
    double* measured_ = nullptr;  // smoothed torques that forces are told from (n) [N m or N]
    double* pulls_ = nullptr;     // the load's force by torques (3, n)
    double* holding_ = nullptr;   // torques of the planned forces (n) [N m or N]
    double largest_ = infinity;   // times the planned squeeze, at which the first contact is at its cap
    double floor_ = 1.0;          // times the planned F_n, which are no less
    double level_ = 0.0;  // times the planned ones under which it slipped, with a margin, where friction is not felt
    double stamps_[feelings], spreads_[feelings] = {}, wrench_[6], acceleration_[3];
    double steady_[3] = {}, moved_ = 0.0;  // the load's force, slowly [N]; mean square of how far it is off [N^2]
    double now_ = -infinity, fresh_ = -infinity, begun_ = -infinity, slipped_ = -infinity, jumped_ = -infinity;
    bool heard_ = false;  // something since the last tick

    // The latency of all, smoothing included [s].
    double lag() const { return setup_.latency + setup_.smoothing + setup_.period; }
    bool is_fresh(Feeling kind) const {
        return now_ - stamps_[static_cast<int>(kind)] <= setup_.blind + setup_.latency;
    }
    bool tells_vectors() const {
        return is_fresh(Feeling::forces) || (setup_.tells_load && is_fresh(Feeling::torques));
    }
    bool tells_normals() const {
        return tells_vectors() || is_fresh(Feeling::normal_forces) || is_fresh(Feeling::torques);
    }
    bool is_settled() const { return now_ - begun_ > settling; }
    bool tells_slips() const { return std::isfinite(stamps_[static_cast<int>(Feeling::slips)]); }

    // Variance of the smoothed vectors, and of the force of the load that they tell, in its worst direction [N^2].
    double find_variances() {
        const double noise = setup_.noise * setup_.noise;
        double whole = 0.0;
        if (is_fresh(Feeling::forces)) {
            for (int i = 0; i < k_; ++i) {
                const double own = noise * spread_of(Feeling::forces) * dot3(felt + 3 * i, felt + 3 * i);
                std::fill_n(variance_ + 3 * i, 3, own);
                whole += own;
            }
            return whole;
        }
        const double each = noise * spread_of(Feeling::torques) + setup_.scale * setup_.scale;
        const auto through = [this, each](const double* row) {
            double sum = 0.0;
            for (int j = 0; j < n_; ++j) sum += row[j] * row[j] * measured_[j] * measured_[j];
            return each * sum;
        };
        for (int r = 0; r < 3 * k_; ++r) variance_[r] = through(setup_.from_torques.data() + r * n_);
        for (int r = 0; r < 3; ++r) whole += through(pulls_ + r * n_);
        return whole;
    }
    double spread_of(Feeling kind) const { return spreads_[static_cast<int>(kind)]; }

    void feel_torques(const double* values, double share) {
        if (is_fresh(Feeling::forces)) return;  // those tell more
        for (int j = 0; j < n_; ++j) measured_[j] += share * (values[j] - measured_[j]);
        for (int r = 0; r < 3 * k_; ++r) {
            const bool normal = r % 3 == 2;
            if (!(normal ? !is_fresh(Feeling::normal_forces) : setup_.tells_load)) continue;
            double found = 0.0;
            for (int j = 0; j < n_; ++j) found += setup_.from_torques[r * n_ + j] * (values[j] - setup_.bias[j]);
            felt[r] += share * ((normal ? max(found, 0.0) : found) - felt[r]);
        }
    }

    // Load and mass.
    void estimate(double dt) {
        const bool felt_vectors = tells_vectors();
        double variance = felt_vectors ? find_variances() : infinity;
        double pull[3];  // gravity less acceleration
        for (int c = 0; c < 3; ++c)
            pull[c] = setup_.gravity[c] - (is_fresh(Feeling::acceleration) ? acceleration_[c] : 0.0);
        const double own = dot3(setup_.gravity, setup_.gravity);
        if (is_fresh(Feeling::wrench)) {
            std::copy_n(wrench_, 6, load);
            variance = setup_.noise * setup_.noise * spread_of(Feeling::wrench) * dot3(load, load);
        } else if (felt_vectors) {
            for (int r = 0; r < 6; ++r) {
                load[r] = 0.0;
                for (int c = 0; c < 3 * k_; ++c) load[r] -= setup_.grasp_map[r * 3 * k_ + c] * felt[c];
            }
        } else {
            std::copy_n(setup_.load, 6, load);
            const double planned = own > 0.0 ? dot3(setup_.load, setup_.gravity) / own : 0.0;
            for (int c = 0; c < 3; ++c) load[c] -= planned * (setup_.gravity[c] - pull[c]);
        }
        // What moves more than noise does has just changed, or the object swings.
        const double share = 1.0 - std::exp(-dt / steady);
        double off = 0.0;
        for (int c = 0; c < 3; ++c) {
            steady_[c] += share * (load[c] - steady_[c]);
            off += (load[c] - steady_[c]) * (load[c] - steady_[c]);
        }
        moved_ += share * (off - moved_);
        load_bound = 3.0 * std::sqrt(max(variance, max(off, moved_) - 2.0 * variance));
        const double square = dot3(pull, pull);
        mass = square > 0.0 ? max(0.0, dot3(load, pull) / square) : 0.0;
    }

    // Bounds of friction: what holds at a ratio has it at least, what slips at one has no more.
    void learn_friction(double dt) {
        // What is learnt is a mean of what is smoothed already.
        // The largest of them is the bound: only a part of a contact may slip at first, or it turns as it slips.
        const double left = std::sqrt(setup_.smoothing / (setup_.smoothing + learning));
        const bool felt_vectors = tells_vectors();
        double slipped = 0.0, share_of = 0.0;
        for (int i = 0; i < k_; ++i) {
            const double normal = felt[3 * i + 2];
            if (felt_vectors && normal > firm) {
                const double ratio = std::hypot(felt[3 * i], felt[3 * i + 1]) / normal;
                const double most = max(max(variance_[3 * i], variance_[3 * i + 1]), variance_[3 * i + 2]);
                const double doubt = std::sqrt(most * (1.0 + ratio * ratio)) / normal;
                const double least = ratio - sure * doubt;
                if (is_settled()) mu_low[i] = max(mu_low[i], (least - tilted) / (1.0 + least * tilted));
                if (slips_long(i)) {
                    const double share = 1.0 - std::exp(-dt / learning);
                    given_[i] = std::isfinite(given_[i]) ? given_[i] + share * (ratio - given_[i]) : ratio;
                    const double bound = given_[i] + 2.0 * left * doubt;
                    mu_high[i] = std::isfinite(mu_high[i]) ? max(mu_high[i], bound) : bound;
                }
            }
            mu_high[i] = max(mu_high[i], mu_low[i]);
            if (std::isfinite(given_[i]) && setup_.mu[i] > 0.0) {
                slipped += max(normal, firm);
                share_of += max(normal, firm) * given_[i] / setup_.mu[i];
            }
        }
        // What slips tells of the others' material, too.
        const double all = slipped > 0.0 ? share_of / slipped : 1.0;
        for (int i = 0; i < k_; ++i)
            mu[i] = min(setup_.mu[i], max(mu_low[i], std::isfinite(given_[i]) ? given_[i] : all * setup_.mu[i]));
    }

    bool slips_long(int i) const { return slipping[i] > 0.0 && since_[i] > sustained; }

    // The squeeze jumps where most of it slips.
    void react() {
        double whole = 0.0, part = 0.0;
        for (int i = 0; i < k_; ++i) {
            const double normal = max(felt[3 * i + 2], 0.0);
            whole += normal;
            if (slips_long(i) && is_fresh(Feeling::slips)) part += normal;
        }
        if (blind || !(part > 0.5 * whole)) return;
        slipped_ = now_;
        // The last jump is not felt yet, or nothing has been measured since.
        if (now_ - jumped_ <= lag() + sustained || stamps_[static_cast<int>(Feeling::slips)] <= jumped_) return;
        jumped_ = now_;
        ++reflexes;
        double sum = 0.0, planned = 0.0;
        for (int i = 0; i < k_; ++i) {
            sum += forces[3 * i + 2];
            planned += setup_.planned[3 * i + 2];
        }
        const double times = planned > 0.0 ? sum / planned : 1.0;
        if (!tells_vectors()) level_ = max(level_, setup_.margin * times);
        floor_ = max(floor_, setup_.jump * times);
    }

    // The least squeeze: falls slowly to the share of the planned one that stays.
    void set_floor(double dt) {
        if (blind) return;
        const bool told = std::isfinite(load_bound) && tells_slips();
        if (is_settled() && now_ - slipped_ > setup_.calm + setup_.latency) {
            floor_ *= std::exp(-dt / setup_.release);
        }
        double squeeze = 0.0, needed = 0.0;
        for (int i = 0; i < k_; ++i) {
            const double normal = max(setup_.planned[3 * i + 2], 0.0);
            squeeze += normal;
            needed += normal * setup_.mu[i] / max(mu[i], 0.05);
        }
        const double slippery = squeeze > 0.0 ? needed / squeeze : 1.0;
        double least = slippery;  // as long as the load is not all in the hand
        if (!told && now_ - begun_ > setup_.blind + setup_.latency) least = max(least, setup_.unfelt);
        if (is_settled()) {
            const double planned = std::sqrt(dot3(setup_.load, setup_.load));
            // What something else supports may be let go at once.
            const double times = planned > 0.0 ? max(lightest, std::sqrt(dot3(load, load)) / planned) : 1.0;
            const double more = slippery * times;
            least = told ? setup_.kept * min(most_times, more) : setup_.unfelt * max(1.0, min(most_times, more));
        }
        floor_ = min(max(max(floor_, level_), min(least, floor_ + dt / raising)), largest_);
    }

    // The wanted forces: those for the load, or, where none hold it with that friction and that squeeze, the planned
    // ones as many times as the squeeze is.
    Tick solve() {
        for (int i = 0; i < k_; ++i) {
            online_.mu[i] = mu[i] / setup_.margin;
            online_.largest[i] = setup_.most[i];
            online_.least[i] = min(floor_ * max(setup_.planned[3 * i + 2], 0.0), setup_.most[i]);
        }
        online_.moved = true;
        std::copy_n(load, 6, online_.wrench);
        const Tick found = online_.tick();
        for (int c = 0; c < 3 * k_; ++c)
            wanted[c] = found == Tick::converged ? online_.forces[c] : max(1.0, floor_) * setup_.planned[c];
        return found;
    }

    // What is felt too much is taken off, and what is felt too little added, slowly; what was taken off is given back
    // at once where more is wanted.
    void follow(double dt, bool feasible) {
        const double share = 1.0 - std::exp(-dt / lag());
        double sum = 0.0, late = 0.0, seen = 0.0, taken = 0.0;
        for (int i = 0; i < k_; ++i) {
            for (int c = 3 * i; c < 3 * i + 3; ++c) lagging_[c] += share * (wanted[c] - lagging_[c]);
            sum += wanted[3 * i + 2];
            late += lagging_[3 * i + 2];
            seen += felt[3 * i + 2];
            taken += more_[3 * i + 2];
        }
        if (taken < 0.0 && (now_ == slipped_ || sum > rising * late)) {
            const double left = std::exp(-dt / dropping);
            for (int c = 0; c < 3 * k_; ++c) more_[c] *= left;
        } else if (feasible && !blind && tells_normals() && is_settled()) {
            const bool vectors = tells_vectors();
            for (int c = 0; c < 3 * k_; ++c) work_[c] = vectors || c % 3 == 2 ? lagging_[c] - felt[c] : 0.0;
            for (int r = 0; r < 3 * k_; ++r) more_[r] += relaxing / lag() * dt * project(r, work_);
            for (int i = 0; i < k_; ++i) {
                const double size = std::sqrt(dot3(more_ + 3 * i, more_ + 3 * i));
                const double most = most_less * std::sqrt(dot3(wanted + 3 * i, wanted + 3 * i));
                for (int c = 3 * i; c < 3 * i + 3; ++c) more_[c] *= size > most ? most / size : 1.0;
            }
        }
    }

    double project(int r, const double* values) const {
        double found = 0.0;
        for (int c = 0; c < 3 * k_; ++c) found += setup_.internal[r * 3 * k_ + c] * values[c];
        return found;
    }

    // Planned forces and internal ones besides, no more than caps and torque limits allow; their torques.
    void command() {
        const double* planned = setup_.planned.data();
        for (int c = 0; c < 3 * k_; ++c) work_[c] = wanted[c] + more_[c] - planned[c];
        double share = 1.0;
        const auto keep = [&share](double least, double now, double change, double most) {
            if (change > 0.0 && now + share * change > most) share = max(0.0, most - now) / change;
            if (change < 0.0 && now + share * change < least) share = max(0.0, now - least) / -change;
        };
        for (int r = 0; r < 3 * k_; ++r) {
            forces[r] = project(r, work_);
            if (r % 3 == 2) keep(-infinity, planned[r], forces[r], setup_.most[r / 3]);
        }
        // A motor at its limit keeps all others from more: they would push the object away.
        for (int j = 0; j < n_; ++j) {
            torques[j] = 0.0;  // their change, until the share is known
            for (int c = 0; c < 3 * k_; ++c) torques[j] += setup_.joint_map[j * 3 * k_ + c] * forces[c];
            keep(-setup_.torque_limit[j], holding_[j], torques[j], setup_.torque_limit[j]);
        }
        for (int j = 0; j < n_; ++j)
            torques[j] = min(max(holding_[j] + share * torques[j], -setup_.torque_limit[j]), setup_.torque_limit[j]);
        for (int r = 0; r < 3 * k_; ++r) forces[r] = planned[r] + share * forces[r];
    }

    static double dot3(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
