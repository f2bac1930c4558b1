// Hands that close on an object: one that is not where it was planned, or as somebody commands them.
//
// The motors follow their commands as servos, within their limits; what touches presses as springs with friction, and
// so does a table. Steps are implicit (Euler, the contacts linearised), so that they may be long: light links and stiff
// springs settle within one. All is seen from the object, as if that stayed where it was planned and the world moved.
#pragma once

#include <tuple>

#include "algebra.hpp"
#include "touch.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// What the motors (m, one at each of the n joints if not told otherwise) are told, a row per step, of which the last
// stays; servos before and from the step `settled`.
struct ClosingCourse {
    std::size_t rows = 0;
    int steps = 0, freed = 0, complete = 0, settled = 0;  // the object is free from a step on; the table leaves; servos
    double step = 0.0, loaded = 0.0;                      // [s] of the closing, under a load
    const double *q = nullptr, *dq = nullptr, *effort = nullptr;                                  // (rows, m)
    const double *soft = nullptr, *soft_damping = nullptr, *stiff = nullptr, *damping = nullptr;  // gains (m)
    const double *inertia = nullptr, *limit = nullptr;                                            // (n), (m)
    // Joints that a motor moves (m, n); where the joints start (n); their damping and limits (n); frames of the hand's
    // root (rows, 4, 4).
    int motors = 0;
    bool elliptic = false;  // friction across and about a normal share one limit, as of soft fingers
    const double *arms = nullptr, *start = nullptr, *passive = nullptr, *lower = nullptr, *upper = nullptr,
                 *roots = nullptr;
};

// The object, where it is planned, and its contacts.
struct Grasped {
    double mass = 0.0, mu = 0.0, torsion = 0.0;  // [kg], [-], [m]
    std::array<double, 9> inertia{};
    Triple centre{}, gravity{};
    bool on_table = false;
    const double* stiffness = nullptr;  // of the hand's parts (p) [N/m]
    Frame root;                         // of the hand
};

// What came of it: how deep the open hand overlaps the object, how far that moved after the grasp was complete and
// turned, how far it moved in the last half of the hold, and in all before.
struct ClosingOutcome {
    double overlap = 0.0, moved = 0.0, turned = 0.0, crept = 0.0, pushed = 0.0;
};

// How far the object may go under a load before it counts as lost [m, rad].
struct Farthest {
    double moved = 0.0, turned = 0.0;
};

class Closer {
public:
    Closer(const TouchScene& scene, const ClosingCourse& course, const Grasped& object)
        : scene_(scene),
          toucher_(scene),
          course_(course),
          object_(object),
          n_(scene.inputs),
          m_(scene.inputs + 6),
          motors_(course.arms ? course.motors : scene.inputs),
          shear_(scene.parts.size()),
          normal_(scene.parts.size()),
          spin_(scene.parts.size()),
          q_(n_),
          rates_(n_),
          ahead_(motors_),
          drive_(motors_),
          weight_(motors_),
          force_(motors_),
          y_(m_),
          right_(m_),
          base_(m_),
          rhs_(m_),
          matrix_(m_ * m_) {
        for (int a = 0; course_.arms && a <= motors_; ++a) {
            begins_.push_back(static_cast<int>(arms_.size()));
            for (int i = 0; i < (a < motors_ ? n_ : 0); ++i)
                if (const double own = course_.arms[a * n_ + i]; own != 0.0) arms_.push_back({i, own});
        }
    }

    // With the object moved by a frame of the world from where it is planned.
    ClosingOutcome close(const Frame& away) {
        begin(away);
        ClosingOutcome found;
        Frame let_go = world_, half = world_;
        const int middle = (course_.settled + course_.steps) / 2;
        int still = 0;
        for (int s = 0; s < course_.steps && still < at_rest; ++s) {
            if (s == course_.settled) {
                let_go = world_;
                found.pushed = length(at(world_) - at(away));
                if (s > 0) settle(s);
            }
            if (s == middle) half = world_;
            look(s);
            if (s == 0)
                for (double gap : touches_.gap) found.overlap = std::max(found.overlap, -gap);
            if (s == 0 && !touches_.depth.empty()) found.overlap = std::max(found.overlap, touches_.depth[0]);
            step(s);
            if (s >= course_.complete && !(length(at(world_) - at(away)) < gone)) {
                found.moved = found.crept = gone;
                return found;
            }
            still = s > course_.settled && is_still() ? still + 1 : 0;
            if (still == at_rest && s < middle) half = world_;
        }
        found.moved = length(at(world_) - at(let_go));
        found.turned = angle(let_go.inverse() * world_);
        found.crept = length(at(world_) - at(half));
        return found;
    }

    // From the object where it is, free, and as told until it is `complete`; then each of the loads (count, 6), world,
    // about the centre of mass, from there. Farthest from where it was under each (count, 2) [m, rad]; what the parts
    // press with before the loads come. Loads after one that loses it are not tried: no numbers.
    void command(const double* loads, int count, const Farthest& bounds, double* farthest, double* pressed) {
        const Frame away{};
        begin(away);
        for (int s = 0; s < course_.complete; ++s) look(s), step(s);
        std::copy(normal_.begin(), normal_.end(), pressed);
        const State closed{world_, speed_, turning_, shear_, spin_, q_, rates_};
        look(course_.complete);
        const Touches touches = touches_;
        const std::vector<Toucher::Held> held = toucher_.held();
        step_ = course_.loaded;
        bool lost = false;
        for (int load = 0; load < count; ++load) {
            farthest[2 * load] = farthest[2 * load + 1] = nan;
            if (lost) continue;
            std::tie(world_, speed_, turning_, shear_, spin_, q_, rates_) = closed;
            toucher_.hold(held);
            touches_ = touches;
            std::copy_n(loads + 6 * load, 6, load_.begin());
            double moved = length(at(world_) - at(away)), turned = angle(world_);
            for (int s = course_.complete, still = 0; s < course_.steps && still < rested; ++s) {
                if (s > course_.complete) look(s);
                step(s);
                moved = std::max(moved, length(at(world_) - at(away))), turned = std::max(turned, angle(world_));
                lost = !(moved < bounds.moved && turned < bounds.turned);
                if (lost) break;
                const bool rests = length({y_[n_], y_[n_ + 1], y_[n_ + 2]}) < slow * bounds.moved &&
                                   length({y_[n_ + 3], y_[n_ + 4], y_[n_ + 5]}) < slow * bounds.turned;
                still = rests ? still + 1 : 0;
            }
            farthest[2 * load] = moved, farthest[2 * load + 1] = turned;
        }
    }

private:
    using State = std::tuple<Frame, Triple, Triple, std::vector<Triple>, std::vector<double>, std::vector<double>,
                             std::vector<double>>;
    static constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    static constexpr double stop = 300.0;                    // [N m/rad, N/m] of the joints' limits
    static constexpr double near = 3e-3, deep = 2e-2;        // [m] of the surface: what may touch in a step
    static constexpr double sink = 1e-4, near_table = 2e-3;  // [m] into the table; above it, what may touch it
    static constexpr double shearing = 2.0;                  // of the normal stiffness
    static constexpr double table_shear = 5e4;               // [N/m]
    static constexpr double least_arm = 1e-3, gone = 0.05;   // [m]
    static constexpr double most_turn = 0.2;                 // [rad] in a step; [m] as well
    static constexpr double lean = 0.1;                      // [rad] of faces that press as areas
    static constexpr double tilt = 0.3;                      // [rad] of directions about down
    static constexpr int around = 16, rounds = 6;
    static constexpr double alike = 1e-7;     // [m, rad] change of a step that ends its rounds
    static constexpr double pressing = 1e-3;  // [m] these links are farther off: they touch at points
    static constexpr double rest = 1e-7;      // [m, rad] of a step; so many of them end the hold
    static constexpr int at_rest = 5;
    static constexpr double slow = 1e-2;  // of how far the object may go under a load: likewise
    static constexpr int rested = 2;

    // Rows of a place that touches, one after the other: normals, two across, one that turns. Each has the columns that
    // move there alone.
    struct Patch {
        int first = 0, normals = 0;
        int begin = 0, columns = 0, stride = 0;           // among the columns; of a row, filled up with zeros
        std::size_t rows = 0;                             // where they begin
        double stiffness = 0.0, shear = 0.0, spin = 0.0;  // of each normal; of the others [N/m, N m/rad]
        double turning = 0.0;                             // limit of the last per newton [m]
        double normal = 0.0;                              // of all normals [N]
        double force[3]{};                                // of the last three, before the step
        double trial[3]{}, share[3]{};
        Triple x{}, y{};
        int part = -1;  // of the hand; -1: the table
    };

    // A joint that a motor moves.
    struct Arm {
        int joint;
        double arm;
    };

    Triple at(const Frame& world) const { return world.act(object_.centre); }

    static double angle(const Frame& frame) {
        const double c = 0.5 * (frame.R[0] + frame.R[4] + frame.R[8] - 1.0);
        return std::acos(std::min(1.0, std::max(-1.0, c)));
    }

    void begin(const Frame& away) {
        world_ = away;
        touched_ = false;
        toucher_.forget();
        speed_ = turning_ = table_shear_ = {};
        table_spin_ = 0.0;
        load_.fill(0.0), step_ = course_.step;
        std::copy_n(course_.start ? course_.start : course_.q, n_, q_.begin());
        std::fill(rates_.begin(), rates_.end(), 0.0);
        std::fill(ahead_.begin(), ahead_.end(), 0.0);
        std::fill(shear_.begin(), shear_.end(), Triple{});
        std::fill(spin_.begin(), spin_.end(), 0.0);
        std::fill(normal_.begin(), normal_.end(), 0.0);
        soft_ = true;
        const double size = length(object_.gravity);
        up_ = size > 0.0 ? (-1.0 / size) * object_.gravity : Triple{0.0, 0.0, 1.0};
        height_ = dot(up_, world_.act(farthest(world_.turn_back(-1.0 * up_))));
    }

    bool is_still() const {
        return std::all_of(y_.begin(), y_.end(), [](double one) { return std::fabs(one) < rest; });
    }

    // From here on the joints are held where they are.
    void settle(int s) {
        soft_ = false;
        const double* told = row(course_.q, s);
        for (int i = 0; i < n_; ++i)
            if (course_.soft[i] < course_.stiff[i]) ahead_[i] = q_[i] - told[i];
    }

    const double* row(const double* rows, int s) const {
        return rows + std::min<std::size_t>(s + 1, course_.rows - 1) * motors_;
    }

    Frame root(int s) const {
        return course_.roots ? frame_at(course_.roots + 16 * std::min<std::size_t>(s + 1, course_.rows - 1))
                             : object_.root;
    }

    void look(int s) {
        touches_.clear();
        toucher_.touch(q_.data(), world_.inverse() * root(s),
                       {near, lean, world_.turn_back(object_.gravity), deep, false, true, course_.arms != nullptr,
                        course_.arms ? pressing : near},
                       touches_);
    }

    // The object's point farthest along a direction.
    Triple farthest(const Triple& along) const {
        return scene_.object.act(scene_.hull.farthest(scene_.object.turn_back(along)));
    }

    void step(int s) {
        const bool fixed = s < course_.freed, stands = object_.on_table && s < course_.complete;
        const std::size_t count = touches_.part.size();
        touched_ = touched_ || count > 0;
        if (!touched_ && !course_.arms && (fixed || stands)) {
            std::copy_n(row(course_.q, s), n_, q_.begin());
            return;
        }
        set_base(s, fixed);
        rows_.clear(), gaps_.clear(), patches_.clear(), columns_.clear();
        for (std::size_t t = 0; t < count; ++t) add_touch(t);
        if (stands && !fixed) add_table();
        std::fill(y_.begin(), y_.end(), 0.0);
        for (int i = 0; i < rounds; ++i) {
            set_motors(i == 0);
            if (press(fixed) < alike && i > 0) break;
        }
        weigh();
        move(fixed);
    }

    // What the motors do in the step without moving (n), and what slows the object.
    void set_base(int s, bool fixed) {
        const double h = step_;
        const double *told = row(course_.q, s), *rate = row(course_.dq, s), *effort = row(course_.effort, s);
        const double *kp = stiffness(), *kd = damping();
        for (int i = 0; i < motors_; ++i)
            drive_[i] = kp[i] * (told[i] + ahead_[i] - moved_by(i, q_)) + effort[i] + kd[i] * rate[i];
        const Triple pushed = world_.turn_back({load_[0], load_[1], load_[2]}),
                     twisted = world_.turn_back({load_[3], load_[4], load_[5]});
        const Triple down = world_.turn_back(object_.gravity), turning = turned(turning_);
        for (int i = 0; i < 3; ++i) {
            base_[n_ + i] = object_.mass / (h * h), base_[n_ + 3 + i] = 0.0;
            right_[n_ + i] = fixed ? 0.0 : object_.mass * (speed_[i] / h + down[i]) + pushed[i];
            right_[n_ + 3 + i] = fixed ? 0.0 : turning[i] / h + twisted[i];
        }
    }

    // A motor's coordinate (joints at `from`).
    double moved_by(int motor, const std::vector<double>& from) const {
        if (!course_.arms) return from[motor];
        double found = 0.0;
        for (int k = begins_[motor]; k < begins_[motor + 1]; ++k) found += arms_[k].arm * from[arms_[k].joint];
        return found;
    }

    const double* stiffness() const { return soft_ ? course_.soft : course_.stiff; }
    const double* damping() const { return soft_ ? course_.soft_damping : course_.damping; }

    // The motors about the step y: servos, or at their limits, where they would ask for more; joints at theirs.
    void set_motors(bool first) {
        const double h = step_;
        for (int i = 0; i < n_; ++i) {
            const double inertia = course_.inertia[i], slowed = course_.passive ? course_.passive[i] : 0.0;
            base_[i] = inertia / (h * h) + slowed / h;
            right_[i] = inertia * rates_[i] / h - touches_.gravity[i];
            if (!course_.lower) continue;
            const double next = q_[i] + y_[i], stopped = std::clamp(next, course_.lower[i], course_.upper[i]);
            if (stopped != next) base_[i] += stop, right_[i] += stop * (stopped - q_[i]);
        }
        for (int i = 0; i < motors_; ++i) {
            const double limit = course_.limit[i], against = stiffness()[i] + damping()[i] / h;
            const double asked = drive_[i] - against * moved_by(i, y_);
            const bool free = first || std::fabs(asked) < limit;
            weight_[i] = free ? against : 0.0, force_[i] = free ? drive_[i] : std::copysign(limit, asked);
            if (!course_.arms) base_[i] += weight_[i], right_[i] += force_[i];
        }
    }

    // Motors of several joints, in the matrix and on the right.
    void add_motors() {
        for (int a = 0; a < motors_; ++a) {
            for (int k = begins_[a]; k < begins_[a + 1]; ++k) {
                const int i = arms_[k].joint;
                rhs_[i] += force_[a] * arms_[k].arm;
                for (int l = k; l < begins_[a + 1]; ++l)
                    matrix_[i * m_ + arms_[l].joint] += weight_[a] * arms_[k].arm * arms_[l].arm;
            }
        }
    }

    Triple turned(const Triple& by) const { return Frame{object_.inertia, {}}.turn(by); }

    // The joints that move a part of the hand, and the object; of the table the object alone.
    void add_columns(int part, Patch& patch) {
        patch.begin = static_cast<int>(columns_.size());
        const auto own = [&] { return columns_.begin() + patch.begin; };
        for (int j = part < 0 ? -1 : scene_.parts[part].joint; j >= 0; j = scene_.joints[j].parent)
            if (std::find(own(), columns_.end(), scene_.joints[j].input) == columns_.end())
                columns_.push_back(scene_.joints[j].input);
        std::sort(own(), columns_.end());
        for (int i = n_; i < m_; ++i) columns_.push_back(i);
        patch.columns = static_cast<int>(columns_.size()) - patch.begin;
        patch.stride = blocks_of(patch.columns) * width;
        patch.rows = rows_.size();
    }

    // A row of how the hand's point `at` comes nearer to the object along a direction; -1: a point that stays.
    void add_row(const Patch& patch, std::int64_t touch, const Triple& along, const Triple& at) {
        const Triple hand = touch < 0 ? Triple{} : cross(at - triple(touches_.points, touch), along);
        add_row(patch, touch, along, hand, cross(at - object_.centre, along));
    }

    // A row of the motion along a direction and about axes: the hand's about the touching point, the object's about its
    // centre.
    void add_row(const Patch& patch, std::int64_t touch, const Triple& along, const Triple& hand,
                 const Triple& object) {
        const std::size_t start = rows_.size();
        rows_.resize(start + static_cast<std::size_t>(patch.stride), 0.0);
        double* to = rows_.data() + start;
        for (const int* j = columns_.data() + patch.begin; *j < n_; ++j, ++to) {
            const double* jacobian = touches_.jacobians.data() + 6 * n_ * touch + *j;
            for (int x = 0; x < 3; ++x) *to += along[x] * jacobian[x * n_] + hand[x] * jacobian[(3 + x) * n_];
        }
        for (int x = 0; x < 3; ++x) to[x] = -along[x], to[3 + x] = -object[x];
    }

    static Triple triple(const std::vector<double>& from, std::size_t i) {
        return {from[3 * i], from[3 * i + 1], from[3 * i + 2]};
    }

    void add_touch(std::size_t t) {
        points_.clear();
        for (int c = 0; c < touches_.counts[t]; ++c) {
            points_.push_back(triple(touches_.corners, 4 * t + c));
            gaps_.push_back(touches_.gap[t] + touches_.leaning[4 * t + c]);
        }
        const int part = static_cast<int>(touches_.part[t]);
        const double stiffness = object_.stiffness[part];
        add_patch(t, triple(touches_.normals, t), part, {stiffness, shearing * stiffness, object_.torsion},
                  {shear_[part], spin_[part]});
    }

    // The object on the table: at the points that are lowest, seen along several directions about down.
    void add_table() {
        const Triple up = world_.turn_back(up_), x = across(up), y = cross(up, x);
        points_.clear();
        for (int i = -1; i < around; ++i) {
            const double turn = 2.0 * 3.14159265358979 * i / around;
            Triple along = -1.0 * up;
            if (i >= 0) along = std::sin(tilt) * (std::cos(turn) * x + std::sin(turn) * y) - std::cos(tilt) * up;
            const Triple point = farthest(along);
            const double above = dot(up_, world_.act(point)) - height_;
            if (above > near_table) continue;
            const auto same = [&](const Triple& one) { return length(one - point) < 1e-9; };
            if (std::any_of(points_.begin(), points_.end(), same)) continue;
            points_.push_back(point), gaps_.push_back(above - sink);
        }
        if (!points_.empty())
            add_patch(-1, up, -1, {object_.mass * length(object_.gravity) / sink, table_shear, 0.0},
                      {world_.turn_back(table_shear_), table_spin_});
    }

    // Stiffness of a patch along its normal and across it [N/m], and its torsion, that of its area apart [m].
    struct Springs {
        double normal, shear, torsion;
    };
    // Forces that friction kept: across, and about the normal.
    struct Kept {
        Triple shear;
        double spin;
    };

    // Rows of the points that touch, whose gaps are there already.
    void add_patch(std::int64_t touch, const Triple& normal, int part, const Springs& springs, const Kept& kept) {
        const int count = static_cast<int>(points_.size());
        Patch patch;
        patch.first = static_cast<int>(gaps_.size()) - count, patch.normals = count, patch.part = part;
        add_columns(part, patch);
        Triple middle{};
        for (const Triple& point : points_) {
            middle = middle + (1.0 / count) * point;
            add_row(patch, touch, normal, point);
        }
        double wide = 0.0;
        for (const Triple& point : points_) wide += dot(point - middle, point - middle) / count;
        patch.turning = springs.torsion + object_.mu * std::sqrt(wide);
        const double arm = std::max(patch.turning / std::max(object_.mu, 1e-6), least_arm);
        patch.stiffness = springs.normal / count, patch.shear = springs.shear, patch.spin = springs.shear * arm * arm;
        patch.x = across(normal), patch.y = cross(normal, patch.x);
        add_row(patch, touch, patch.x, middle), add_row(patch, touch, patch.y, middle);
        add_row(patch, touch, {}, normal, normal);
        patch.force[0] = dot(patch.x, kept.shear), patch.force[1] = dot(patch.y, kept.shear),
        patch.force[2] = kept.spin;
        gaps_.insert(gaps_.end(), 3, 0.0);
        patches_.push_back(patch);
    }

    // How far the step y goes along the rows of a patch.
    void go_along(const Patch& patch) {
        const int* at = columns_.data() + patch.begin;
        there_.assign(patch.stride, 0.0);
        for (int c = 0; c < patch.columns; ++c) there_[c] = y_[at[c]];
        const double* own = rows_.data() + patch.rows;
        for (int i = patch.first; i < patch.first + patch.normals + 3; ++i, own += patch.stride) {
            Vector found = 0.0;
            for (int c = 0; c < patch.stride; c += width) found = found + lanes_at(own + c) * lanes_at(&there_[c]);
            along_[i] = sum(found);
        }
    }

    // What friction lets of the forces across, at the step y.
    void weigh() {
        along_.resize(gaps_.size());
        for (Patch& patch : patches_) {
            go_along(patch);
            double normal = 0.0;
            for (int i = patch.first; i < patch.first + patch.normals; ++i)
                normal += patch.stiffness * std::max(0.0, along_[i] - gaps_[i]);
            patch.normal = normal;
            const int next = patch.first + patch.normals;
            for (int i = 0; i < 3; ++i)
                patch.trial[i] = patch.force[i] + (i < 2 ? patch.shear : patch.spin) * along_[next + i];
            const double size = std::sqrt(patch.trial[0] * patch.trial[0] + patch.trial[1] * patch.trial[1]),
                         turning = std::fabs(patch.trial[2]);
            if (course_.elliptic) {
                const double all =
                    std::hypot(size / std::max(object_.mu, 1e-9), turning / std::max(patch.turning, 1e-9));
                patch.share[0] = patch.share[1] = patch.share[2] = all > normal ? normal / all : 1.0;
                continue;
            }
            patch.share[0] = patch.share[1] = size > object_.mu * normal ? object_.mu * normal / size : 1.0;
            patch.share[2] = turning > patch.turning * normal ? patch.turning * normal / turning : 1.0;
        }
    }

    // One round: the step y with what presses, and friction's shares, as of the last; how much it changed.
    double press(bool fixed) {
        weigh();
        const double h = step_;
        std::fill(matrix_.begin(), matrix_.end(), 0.0);
        for (int i = 0; i < m_; ++i) matrix_[i * m_ + i] = base_[i], rhs_[i] = right_[i];
        for (int i = 0; i < 3; ++i)
            for (int j = i; j < 3; ++j) matrix_[(n_ + 3 + i) * m_ + n_ + 3 + j] += object_.inertia[3 * i + j] / (h * h);
        if (course_.arms) add_motors();
        for (const Patch& patch : patches_) add_springs(patch);
        if (fixed)  // the object stays
            for (int i = n_; i < m_; ++i) {
                for (int j = 0; j <= i; ++j) matrix_[j * m_ + i] = 0.0;
                matrix_[i * m_ + i] = 1.0, rhs_[i] = 0.0;
            }
        factor(matrix_.data(), m_);
        solve(matrix_.data(), rhs_.data(), m_);
        double changed = 0.0;
        for (int i = 0; i < m_; ++i) {
            const double bounded = std::min(most_turn, std::max(-most_turn, rhs_[i]));
            changed = std::max(changed, std::fabs(bounded - y_[i]));
            y_[i] = bounded;
        }
        return changed;
    }

    // The springs of a patch, in the matrix and on the right.
    void add_springs(const Patch& patch) {
        const int* at = columns_.data() + patch.begin;
        const int size = patch.columns, stride = patch.stride;
        block_.assign((size + 1) * stride, 0.0);
        double* force = &block_[size * stride];
        const double* row = rows_.data() + patch.rows;
        for (int i = patch.first; i < patch.first + patch.normals; ++i, row += stride)
            if (along_[i] > gaps_[i]) add_spring(patch, row, patch.stiffness, -patch.stiffness * gaps_[i], force);
        for (int i = 0; i < 3; ++i)
            add_spring(patch, row + i * stride, patch.share[i] * (i < 2 ? patch.shear : patch.spin),
                       patch.share[i] * patch.force[i], force);
        for (int i = 0; i < size; ++i) {
            rhs_[at[i]] -= force[i];
            double* to = matrix_.data() + static_cast<std::size_t>(at[i]) * m_;
            for (int j = i; j < size; ++j) to[at[j]] += block_[i * stride + j];
        }
    }

    // A spring's stiffness along a row, and its force at the step 0: in the block, and in what follows it.
    void add_spring(const Patch& patch, const double* row, double stiffness, double force, double* forces) {
        if (stiffness == 0.0 && force == 0.0) return;
        for (int j = 0; j < patch.stride; j += width)
            store(lanes_at(forces + j) + Vector(force) * lanes_at(row + j), forces + j);
        for (int i = 0; i < patch.columns; ++i) {
            const Vector scaled = stiffness * row[i];
            double* to = block_.data() + i * patch.stride;
            for (int j = i / width * width; j < patch.stride; j += width)
                store(lanes_at(to + j) + scaled * lanes_at(row + j), to + j);
        }
    }

    // Takes the step y, and keeps the forces of friction.
    void move(bool fixed) {
        const double h = step_;
        std::fill(shear_.begin(), shear_.end(), Triple{});
        std::fill(spin_.begin(), spin_.end(), 0.0);
        std::fill(normal_.begin(), normal_.end(), 0.0);
        table_shear_ = {}, table_spin_ = 0.0;
        for (const Patch& patch : patches_) {
            const Triple shear =
                (patch.share[0] * patch.trial[0]) * patch.x + (patch.share[1] * patch.trial[1]) * patch.y;
            const double spin = patch.share[2] * patch.trial[2];
            if (patch.part < 0)
                table_shear_ = world_.turn(shear), table_spin_ = spin;
            else
                shear_[patch.part] = shear, spin_[patch.part] = spin, normal_[patch.part] = patch.normal;
        }
        for (int i = 0; i < n_; ++i) q_[i] += y_[i], rates_[i] = y_[i] / h;
        if (fixed) return;
        const Triple by{y_[n_], y_[n_ + 1], y_[n_ + 2]}, turn{y_[n_ + 3], y_[n_ + 4], y_[n_ + 5]};
        Frame moved = rotate_by(turn);
        moved.t = object_.centre + by - moved.turn(object_.centre);
        world_ = world_ * moved;
        speed_ = (1.0 / h) * moved.turn_back(by), turning_ = (1.0 / h) * turn;
    }

    const TouchScene& scene_;
    Toucher toucher_;
    const ClosingCourse& course_;
    const Grasped& object_;
    const int n_, m_, motors_;
    Frame world_;                                        // from what the object sees to the world
    Triple speed_{}, turning_{}, up_{}, table_shear_{};  // of the object, as it sees them; in the world
    double table_spin_ = 0.0, height_ = 0.0, step_ = 0.0;
    bool touched_ = false, soft_ = true;
    Touches touches_;
    std::array<double, 6> load_{};
    std::vector<Triple> shear_, points_;  // of the parts; of a patch
    std::vector<double> normal_, spin_, q_, rates_, ahead_, drive_, weight_, force_, y_, right_, base_, rhs_, matrix_,
        block_, rows_, gaps_, along_, there_;
    std::vector<Arm> arms_;  // of the motors, one after the other, that of motor a from begins_[a] on
    std::vector<int> begins_;
    std::vector<int> columns_;  // of the patches
    std::vector<Patch> patches_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
