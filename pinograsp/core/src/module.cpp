// The core for Python: arrays in, arrays out. Compiled once for each kind of processor, a module each.
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include "pinograsp/core.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace pinograsp::core;

namespace {

using Numbers = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Wrench = nb::ndarray<const double, nb::shape<6>, nb::c_contig, nb::device::cpu>;
using Written = nb::ndarray<double, nb::c_contig, nb::device::cpu>;
using WrittenIndices = nb::ndarray<std::int64_t, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<bool, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const std::int64_t, nb::c_contig, nb::device::cpu>;
using View = nb::ndarray<nb::numpy, double>;

// A view of memory that `owner` keeps.
View view(double* values, std::initializer_list<std::size_t> shape, nb::handle owner) {
    return View(values, shape.size(), shape.begin(), owner);
}

// Indices in memory that `owner` keeps.
nb::ndarray<nb::numpy, std::int64_t, nb::ndim<1>> view(std::vector<std::int64_t>& values, nb::handle owner) {
    return {values.data(), {values.size()}, owner};
}

// The same of values of each contact, one or three, or, with a width of 0, of each joint.
View view_of(double* values, int width, std::size_t contacts, std::size_t joints, nb::handle owner) {
    if (width == 0) return view(values, {joints}, owner);
    if (width == 3) return view(values, {contacts, 3}, owner);
    return view(values, {contacts}, owner);
}

void need(bool fits, const char* what) {
    if (!fits) throw nb::value_error(what);
}

void need_number(double value, bool positive, const char* what) {
    need(std::isfinite(value) && value >= 0.0 && (value > 0.0 || !positive), what);
}

const double* sized(const Numbers& values, std::size_t size, const char* what) {
    need(values.size() == size, what);
    return values.data();
}

// Of that size, every number finite.
const double* finite(const Numbers& values, std::size_t size, const char* what) {
    const double* own = sized(values, size, what);
    need(std::all_of(own, own + size, [](double one) { return std::isfinite(one); }), what);
    return own;
}

// Pairs (coefficient, exponent) of powers of F_n.
void need_terms(const Numbers& terms) {
    need(terms.size() % 2 == 0, "terms");
    for (std::size_t i = 0; i < terms.size(); i += 2)
        need(std::isfinite(terms.data()[i]) && terms.data()[i + 1] >= 1.0 && terms.data()[i + 1] <= 100.0, "terms");
}

// -- one problem ------------------------------------------------------------------------------------------------------

std::unique_ptr<Forces> grasp_from(const GraspSetup& setup) {
    auto forces = make_forces(setup);
    need(forces != nullptr, fault_of(setup));
    return forces;
}

// A problem of the grasp's rows that was made elsewhere; its arrays stay those of the caller.
Problem problem_of(const Forces& forces, const Numbers& b, const Numbers& lo, const Numbers& hi, const Numbers& R_lo,
                   const Numbers& R_hi, const Numbers& P, const Numbers& q, const Numbers& terms, double peak) {
    const std::size_t k = forces.contacts(), r = forces.torque_rows(), d = forces.components();
    Problem problem =
        forces.problem(sized(b, forces.balance_rows(), "b"), sized(lo, k, "lo"), sized(hi, k, "hi"),
                       sized(R_lo, r, "R_lo"), sized(R_hi, r, "R_hi"), sized(P, d * d * k, "P"), sized(q, d * k, "q"));
    need_terms(terms);
    need(powers_of(terms.data(), static_cast<int>(terms.size()) / 2, 1.0, 1.0, problem.powers), "terms");
    need_number(peak, false, "peak");
    need(forces.has_peak() || peak == 0.0, "peak");
    problem.peak = peak;
    return problem;
}

// The answer to such a problem: (code, newton, violation, value, bound, x, y, gauge, residual).
nb::tuple answer(Forces& forces, bool newton, Numbers b, Numbers lo, Numbers hi, Numbers R_lo, Numbers R_hi, Numbers P,
                 Numbers q, Numbers terms, double peak) {
    const int k = forces.contacts(), m = forces.balance_rows(), r = forces.torque_rows(), n = forces.components() * k;
    const Checked found = forces.answer(newton, problem_of(forces, b, lo, hi, R_lo, R_hi, P, q, terms, peak));
    const auto copied = [](const double* values, std::size_t size) {
        double* own = new double[size];
        std::copy(values, values + size, own);
        return View(own, {size}, nb::capsule(own, [](void* p) noexcept { delete[] static_cast<double*>(p); }));
    };
    return nb::make_tuple(static_cast<int>(found.code), found.newton, found.violation, found.value, found.bound,
                          copied(forces.x(), n), copied(forces.y(), m + r), copied(forces.gauge(), k),
                          copied(forces.residual(), m));
}

// Lower bound of the objective, and Farkas bound, of multipliers y (m + r) of such a problem, near x (d k).
nb::tuple bounds(Forces& forces, Numbers b, Numbers lo, Numbers hi, Numbers R_lo, Numbers R_hi, Numbers P, Numbers q,
                 Numbers terms, double peak, Numbers x, Numbers y) {
    const Problem problem = problem_of(forces, b, lo, hi, R_lo, R_hi, P, q, terms, peak);
    const double* near = sized(x, static_cast<std::size_t>(forces.components()) * forces.contacts(), "x");
    const double* multipliers = sized(y, forces.balance_rows() + forces.torque_rows(), "y");
    return nb::make_tuple(bound_of(problem, near, multipliers).bound, excluded(problem, multipliers));
}

// A grasp's problem at one impact time, for one objective, for one load after the other.
struct Prepared {
    nb::object grasp;  // keeps the grasp's memory
    Forces* forces;
    bool newton;
    std::vector<double> least, greatest, terms;
    Tolerance tolerance;

    Prepared(nb::object own, bool by_newton, Numbers low, Numbers high, Numbers powers, double residual,
             double violation, double gap, double vanishing, double negligible)
        : grasp(own),
          forces(nb::cast<Forces*>(own)),
          newton(by_newton),
          least(low.data(), low.data() + low.size()),
          greatest(high.data(), high.data() + high.size()),
          terms(powers.data(), powers.data() + powers.size()),
          tolerance{residual, violation, gap, vanishing, negligible} {
        need(forces != nullptr, "grasp");
        need(least.size() == static_cast<std::size_t>(forces->contacts()) && greatest.size() == least.size(),
             "limits of F_n");
        for (std::size_t i = 0; i < least.size(); ++i) need(least[i] >= 0.0 && greatest[i] >= 0.0, "limits of F_n");
        for (double one : {residual, violation, gap, vanishing, negligible}) need_number(one, false, "tolerances");
        need_terms(powers);
        Powers found;
        need(powers_of(terms.data(), static_cast<int>(terms.size()) / 2, 1.0, 1.0, found), "terms");
    }

    // Numbers (6 + 4 k): wrench, forces, torsion; active (3 k + r).
    Record record_in(Written& numbers, Flags& active) const {
        const int k = forces->contacts(), r = forces->torque_rows();
        need(numbers.size() == static_cast<std::size_t>(6 + 4 * k) &&
                 active.size() == static_cast<std::size_t>(3 * k + r),
             "room for the results");
        double* out = numbers.data();
        bool* at = active.data();
        return {out, out + 6, out + 6 + 3 * k, at, at + k, at + 2 * k, at + 3 * k};
    }

    // Fills the direction of the proof (m + r), and numbers and active of the closest forces; 0: not proven.
    double prove(Wrench load, Written direction, Written numbers, Flags active) const {
        need(direction.size() == static_cast<std::size_t>(forces->balance_rows() + forces->torque_rows()),
             "room for the direction");
        return forces->prove(least.data(), greatest.data(), load.data(), record_in(numbers, active), direction.data());
    }

    // Fills numbers and active.
    nb::tuple solve(Wrench load, Written numbers, Flags active) const {
        const Record record = record_in(numbers, active);
        const Outcome found = forces->solve(newton, least.data(), greatest.data(), terms.data(),
                                            static_cast<int>(terms.size()) / 2, load.data(), record);
        const Certificate sure(found, tolerance);
        return nb::make_tuple(sure.optimal, found.checked.newton, sure.objective, sure.lower_bound, sure.residual_norm,
                              sure.violation, sure.load_size, sure.force_size, sure.objective_size);
    }
};

// -- tick by tick -----------------------------------------------------------------------------------------------------

class Loop {
public:
    explicit Loop(const OnlineSetup& setup) : online(make_online(setup)) {
        need(online != nullptr, fault_of(setup));
        for (const Link& link : setup.links) columns_ = std::max(columns_, static_cast<std::size_t>(link.column) + 1);
        gravity_.assign(setup.joints, 0.0);
        online->gravity = gravity_.data();
    }

    std::unique_ptr<Online> online;

    // The Jacobian's memory is looked at in every tick; gravity (n) is copied.
    void hand(Numbers jacobian, Numbers gravity) {
        need(jacobian.size() >= 6 * columns_ && jacobian.size() % 6 == 0, "jacobian");
        jacobian_ = jacobian;
        online->jacobian = jacobian.data();
        this->gravity(gravity);
    }

    void gravity(Numbers values) {
        need(values.size() == gravity_.size(), "gravity");
        std::copy(values.data(), values.data() + values.size(), gravity_.begin());
    }

    void place(Numbers points, Numbers rotations) {
        const std::size_t k = online->setup().contacts;
        std::copy_n(sized(points, 3 * k, "points"), 3 * k, online->points);
        std::copy_n(sized(rotations, 9 * k, "rotations"), 9 * k, online->rotations);
        online->moved = true;
    }

    void rub(Numbers mu) {
        const std::size_t k = online->setup().contacts;
        std::copy_n(sized(mu, k, "mu"), k, online->mu);
        online->moved = true;
    }

    int step(Wrench load) {
        std::copy_n(load.data(), 6, online->wrench);
        return static_cast<int>(online->tick());
    }

    void engage(int contact, bool touches, bool at_once) {
        need(contact >= 0 && contact < online->setup().contacts, "contact");
        online->engage(contact, touches, at_once);
    }

private:
    Numbers jacobian_;
    std::vector<double> gravity_;
    std::size_t columns_ = 0;  // that links name
};

// -- a squeeze that follows what is felt ------------------------------------------------------------------------------

class GripLoop {
public:
    // Keeps the loop that it computes on.
    GripLoop(nb::object loop, const GripSetup& setup) : loop_(loop) {
        Online& online = *nb::cast<Loop&>(loop).online;
        const char* fault = fault_of(setup, online.setup());
        need(fault == nullptr, fault);
        grip = std::make_unique<Grip>(online, setup);
    }

    std::unique_ptr<Grip> grip;

    bool feel(int kind, Numbers values, double time) {
        need(kind >= 0 && kind < feelings, "kind");
        const Feeling which = static_cast<Feeling>(kind);
        need(values.size() == static_cast<std::size_t>(grip->size_of(which)), "values");
        return grip->feel(which, values.data(), time);
    }

private:
    nb::object loop_;
};

// -- multipliers ------------------------------------------------------------------------------------------------------

struct Box {
    virtual ~Box() = default;
    virtual bool solve(const double* load) = 0;
    std::vector<double> k;
};

template <int M>
struct BoxOf final : Box {
    BoxOf(const double* H, int n, double eps, const double* fixed, const double* row) : method(H, n, eps) {
        k.assign(n, 0.0);
        std::copy_n(fixed, M, fixed_);
        std::copy_n(row, M, row_);
    }

    bool solve(const double* load) override {
        double b[M];
        for (int r = 0; r < M; ++r) b[r] = fixed_[r] + row_[r] * load[r];
        return method.solve(b, k.data());
    }

    BoxLeastSquares<M> method;
    double fixed_[M], row_[M];
};

std::unique_ptr<Box> make_box(Numbers H, double eps, Numbers fixed, Numbers row) {
    need(H.ndim() == 2 && (H.shape(0) == 3 || H.shape(0) == 6) && H.shape(1) > 0 && H.shape(1) <= most_contacts, "H");
    const int m = static_cast<int>(H.shape(0)), n = static_cast<int>(H.shape(1));
    finite(H, H.size(), "H");
    finite(fixed, m, "fixed");
    finite(row, m, "row");
    need_number(eps, true, "eps");
    if (m == 3) return std::make_unique<BoxOf<3>>(H.data(), n, eps, fixed.data(), row.data());
    return std::make_unique<BoxOf<6>>(H.data(), n, eps, fixed.data(), row.data());
}

// -- many problems ----------------------------------------------------------------------------------------------------

using Codes = nb::ndarray<std::int64_t, nb::c_contig, nb::device::cpu>;

// What all that is asked of many problems has in common.
Batch batch_of(std::int64_t start, std::int64_t stop, int components, int round, double torsion, const Numbers& points,
               const Numbers& rotations, const Indices& counts, const Numbers& loads, const Numbers& low,
               const Numbers& high, const Numbers& arms) {
    const std::size_t n = counts.size(), k = n ? low.size() / n : 0;
    need(k > 0 && k <= most_contacts && start >= 0 && start <= stop && stop <= static_cast<std::int64_t>(n) &&
             has_shape(components, round),
         "problems");
    need_number(torsion, false, "torsion");
    for (std::size_t i = 0; i < n; ++i)
        need(counts.data()[i] >= 0 && counts.data()[i] <= static_cast<std::int64_t>(k), "counts");
    need(points.size() == 3 * n * k && rotations.size() == 9 * n * k && loads.size() == 6 * n && low.size() == n * k &&
             high.size() == n * k && arms.size() == n,
         "sizes of a batch");
    Batch own;
    own.k = static_cast<int>(k);
    own.torsion = torsion;
    own.points = points.data();
    own.rotations = rotations.data();
    own.counts = counts.data();
    own.loads = loads.data();
    own.low = low.data();
    own.high = high.data();
    own.arms = arms.data();
    return own;
}

void batch(std::int64_t start, std::int64_t stop, int components, int round, int rows, double torsion, double squares,
           Numbers points, Numbers rotations, Indices counts, Numbers loads, Numbers mu, Numbers low, Numbers high,
           Numbers arms, Numbers terms, Written forces, Written moments, Written objective, Written lower_bound,
           Written residual, Written violation, Codes codes) {
    Batch own = batch_of(start, stop, components, round, torsion, points, rotations, counts, loads, low, high, arms);
    const std::size_t n = counts.size(), k = own.k;
    need(rows == 3 || rows == 6, "problems");
    need_number(squares, false, "squares");
    need(mu.size() == n * k && terms.size() % (2 * n) == 0 && forces.size() == 3 * n * k && moments.size() == n * k &&
             objective.size() == n && lower_bound.size() == n && residual.size() == n && violation.size() == n &&
             codes.size() == n,
         "sizes of a batch");
    own.t = static_cast<int>(terms.size() / (2 * n));
    own.moments = rows == 6;
    own.squares = squares;
    own.mu = mu.data();
    own.terms = terms.data();
    BatchResults results{forces.data(),   moments.data(),   objective.data(), lower_bound.data(),
                         residual.data(), violation.data(), codes.data()};
    nb::gil_scoped_release released;
    solve_batch(own, components, round, start, stop, results);
}

// Fills the least friction over the safety factor, up to `most` and to `within`; a code says whether it is known.
void least_mu(std::int64_t start, std::int64_t stop, int components, int round, double torsion, double most,
              double within, Numbers points, Numbers rotations, Indices counts, Numbers loads, Numbers low,
              Numbers high, Numbers arms, Written least, Codes codes) {
    Batch own = batch_of(start, stop, components, round, torsion, points, rotations, counts, loads, low, high, arms);
    need_number(most, true, "most");
    need_number(within, true, "within");
    need(least.size() == counts.size() && codes.size() == counts.size(), "sizes of a batch");
    own.most_mu = most;
    own.within = within;
    BatchResults results;
    results.least_mu = least.data();
    results.codes = codes.data();
    nb::gil_scoped_release released;
    solve_batch(own, components, round, start, stop, results);
}

// -- contacts as springs ----------------------------------------------------------------------------------------------

void need_rows(const Indices& rows, std::size_t count, const char* what) {
    for (std::size_t i = 0; i < rows.size(); ++i)
        need(rows.data()[i] >= 0 && rows.data()[i] < static_cast<std::int64_t>(count), what);
}

Reactions reactions_of(Written& change, Flags& borne, const Indices& counts, const std::optional<Indices>& rows) {
    need(change.ndim() == 4 && borne.ndim() == 2 && borne.shape(0) == change.shape(0) &&
             borne.shape(1) == change.shape(3) && counts.size() == change.shape(0),
         "reactions");
    Reactions own;
    own.k = static_cast<int>(change.shape(1));
    own.d = static_cast<int>(change.shape(2));
    own.m = static_cast<int>(change.shape(3));
    need((own.d == 3 || own.d == 4) && own.m % width == 0, "reactions");
    own.change = change.data();
    own.borne = borne.data();
    own.counts = counts.data();
    for (std::size_t i = 0; i < counts.size(); ++i) need(own.counts[i] >= 0 && own.counts[i] <= own.k, "counts");
    if (rows) own.rows = rows->data();
    if (rows) need_rows(*rows, change.shape(0), "rows");
    return own;
}

void need_part(std::int64_t start, std::int64_t stop, std::size_t size) {
    need(start >= 0 && start <= stop && stop <= static_cast<std::int64_t>(size), "start, stop");
}

// Fills change and borne; `whole` and capacities: tangential forces spread accordingly, normal ones the same.
void react(std::int64_t start, std::int64_t stop, double torsion, Numbers points, Numbers rotations, Indices counts,
           Numbers arms, Numbers wrenches, Written change, Flags borne, std::optional<Written> whole,
           std::optional<Flags> whole_borne, std::optional<Numbers> capacities) {
    const Reactions into = reactions_of(change, borne, counts, {});
    const std::size_t n = counts.size(), k = into.k;
    need_part(start, stop, n);
    Springs own;
    own.k = into.k;
    own.d = into.d;
    own.m = into.m;
    own.torsion = torsion;
    own.points = sized(points, 3 * n * k, "points");
    own.rotations = sized(rotations, 9 * n * k, "rotations");
    own.counts = counts.data();
    own.arms = sized(arms, n, "arms");
    own.wrenches = sized(wrenches, 6 * own.m, "wrenches");
    Reactions before;
    if (whole) {
        need(whole_borne && capacities && whole->size() == change.size(), "whole");
        before = reactions_of(*whole, *whole_borne, counts, {});
        need(before.k == into.k && before.d == into.d, "whole");
        sized(*capacities, n * k, "capacities");
    }
    nb::gil_scoped_release released;
    SpringBalance springs(own, into);
    if (whole)
        springs.spread(start, stop, before, capacities->data());
    else
        springs.alike(start, stop);
}

// What friction allows, for reactions of d components.
Limits limits_of(const Reactions& own, int round, const Numbers& limits, const Numbers& facets) {
    const std::size_t size = own.d - 1;
    need(has_shape(own.d, round) && facets.size() % size == 0, "friction");
    const double* each = finite(limits, size, "limits");
    for (std::size_t j = 0; j < size; ++j) need(each[j] > 0.0, "limits");
    return {round, static_cast<int>(facets.size() / size), each, finite(facets, facets.size(), "facets")};
}

void offsets(std::int64_t start, std::int64_t stop, Written change, Flags borne, Indices counts, Indices rows,
             int round, Numbers limits, Numbers facets, std::optional<Numbers> local, Numbers shares, Written offsets) {
    const Reactions own = reactions_of(change, borne, counts, rows);
    const Limits friction = limits_of(own, round, limits, facets);
    const std::size_t n = rows.size();
    need_part(start, stop, n);
    need(offsets.size() == n * own.k && shares.size() == n, "offsets, shares");
    const double* forces = local ? sized(*local, n * own.k * own.d, "local") : nullptr;
    nb::gil_scoped_release released;
    find_offsets(own, friction, start, stop, forces, shares.data(), offsets.data());
}

void multiples(std::int64_t start, std::int64_t stop, Written change, Flags borne, Indices counts, Indices rows,
               int round, Numbers limits, Numbers facets, Numbers local, Written multiples) {
    const Reactions own = reactions_of(change, borne, counts, rows);
    const Limits friction = limits_of(own, round, limits, facets);
    const std::size_t n = rows.size();
    need_part(start, stop, n);
    need(multiples.size() == n * own.m, "multiples");
    sized(local, n * own.k * own.d, "local");
    nb::gil_scoped_release released;
    find_multiples(own, friction, start, stop, local.data(), multiples.data());
}

void efforts(std::int64_t start, std::int64_t stop, Written change, Flags borne, Indices counts, Indices rows,
             Numbers jacobians, Indices places, Numbers rotations, Numbers bias, Numbers local, Written torques,
             Written most) {
    const Reactions own = reactions_of(change, borne, counts, rows);
    const std::size_t n = rows.size(), joints = n ? bias.size() / n : 0;
    need_part(start, stop, n);
    Efforts of;
    of.joints = static_cast<int>(joints);
    of.bias = sized(bias, n * joints, "bias");
    need(jacobians.ndim() == 4 && jacobians.shape(1) == static_cast<std::size_t>(own.k) && jacobians.shape(2) == 6 &&
             jacobians.shape(3) == joints && places.size() == n,
         "jacobians");
    need_rows(places, jacobians.shape(0), "places");
    of.jacobians = jacobians.data();
    of.places = places.data();
    of.rotations = sized(rotations, 9 * n * own.k, "rotations");
    of.local = sized(local, n * own.k * own.d, "local");
    need(torques.size() == n * joints && most.size() == n * joints, "torques");
    of.torques = torques.data();
    of.most = most.data();
    nb::gil_scoped_release released;
    find_efforts(own, start, stop, of);
}

// A field of numbers: an array of any shape goes in, row by row.
template <class Setup>
void array_of(nb::class_<Setup>& record, const char* name, std::vector<double> Setup::* field) {
    record.def_prop_rw(
        name, [field](const Setup& own) { return own.*field; },
        [field](Setup& own, const Numbers& values) {
            (own.*field).assign(values.data(), values.data() + values.size());
        });
}

// -- a hand on its way to an object -----------------------------------------------------------------------------------

Triple triple_of(const double* values) { return {values[0], values[1], values[2]}; }

Frame frame_of(const Numbers& values) { return frame_at(finite(values, 16, "frame")); }

std::vector<Triple> triples_of(const Numbers& values, const char* what) {
    need(values.size() % 3 == 0, what);
    const double* own = finite(values, values.size(), what);
    std::vector<Triple> found;
    for (std::size_t i = 0; i < values.size(); i += 3) found.push_back(triple_of(own + i));
    return found;
}

// Points (n, 3), none of an unknown shape, and radii (3).
Solid solid_of(const Numbers& points, const Numbers& radii) {
    const double* own = finite(radii, 3, "radii");
    need(std::all_of(own, own + 3, [](double one) { return one >= 0.0; }), "radii");
    return Solid(triples_of(points, "points"), triple_of(own));
}

int joint_of(const std::vector<Joint>& joints, std::int64_t joint) {
    need(joint >= -1 && joint < static_cast<std::int64_t>(joints.size()), "joint");
    return static_cast<int>(joint);
}

// The next of them: its parent is there already.
Joint make_joint(const std::vector<Joint>& joints, std::int64_t parent, std::int64_t input, const Numbers& frame,
                 const Numbers& screw) {
    need(input >= 0 && input < 100000, "input");
    const double* own = finite(screw, 6, "screw");
    return {joint_of(joints, parent), static_cast<int>(input), frame_of(frame), triple_of(own), triple_of(own + 3)};
}

// A hand's joints and parts, and an object, added one by one.
struct Approach {
    Way way;
    Margins margins;
    std::size_t inputs = 0;

    Approach(double touch, double creep, double near) : margins{touch, creep, near} {
        for (double one : {touch, creep, near}) need_number(one, true, "margins");
    }

    void add_joint(std::int64_t parent, std::int64_t input, Numbers frame, Numbers screw) {
        way.joints.push_back(make_joint(way.joints, parent, input, frame, screw));
        inputs = std::max(inputs, static_cast<std::size_t>(input) + 1);
    }

    void add_part(std::int64_t joint, Numbers frame, Numbers corners, Numbers points, Numbers radii) {
        Part part{joint_of(way.joints, joint), frame_of(frame), solid_of(points, radii), {}};
        const double* own = finite(corners, 24, "corners");
        for (std::size_t i = 0; i < 8; ++i) part.corners[i] = triple_of(own + 3 * i);
        way.parts.push_back(std::move(part));
    }

    // Where it gets, and in how many steps; `known` (7, p): the rows of `Known`.
    nb::tuple pursue(double at, double end, Numbers q, Numbers rate, Numbers object_pose, Written known, int most) {
        const std::size_t p = way.parts.size();
        need(q.size() >= inputs && rate.size() == q.size(), "q, rate");
        need(known.size() == 7 * p, "known");
        double* row = known.data();
        int left = most;
        const double reached =
            way.pursue(at, end, finite(q, q.size(), "q"), finite(rate, rate.size(), "rate"), frame_of(object_pose),
                       {row, row + p, row + 2 * p, row + 3 * p, row + 4 * p, row + 5 * p, row + 6 * p}, margins, left);
        return nb::make_tuple(reached, most - left);
    }
};

// -- where hands touch an object --------------------------------------------------------------------------------------

// Triangles (m, 3, 3) of a surface.
Body surface_of(const Numbers& triangles) {
    need(triangles.size() % 9 == 0, "triangles");
    const std::vector<Triple> corners = triples_of(triangles, "triangles");
    std::vector<Solid> pieces;
    for (std::size_t i = 0; i < corners.size(); i += 3)
        pieces.push_back(Solid({corners[i], corners[i + 1], corners[i + 2]}, {}));
    return Body(std::move(pieces));
}

// A convex shape, or a surface of triangles.
struct SolidShape {
    Body own;

    SolidShape(Numbers points, Numbers radii, Numbers triangles)
        : own(points.size() > 0 ? Body(solid_of(points, radii)) : surface_of(triangles)) {
        need(!own.empty(), "points, triangles");
    }
};

nb::tuple tuple_of(const Triple& numbers) { return nb::make_tuple(numbers[0], numbers[1], numbers[2]); }

// Depth, normal and point of a shape at `at` (4, 4) in an object at `pose`, from a normal (3); `how` (5): as in
// `DepthSearch`. Nothing where there is no way out along the normals found.
nb::object depth_of(const SolidShape& part, const Numbers& at, const Body& object, const Numbers& pose,
                    const Numbers& normal, const Numbers& how, int rounds) {
    const double* given = finite(how, 5, "how");
    need(!object.empty() && rounds >= 0 && rounds <= 1000, "object, rounds");
    const Depth found =
        find_depth(part.own, frame_of(at), object, frame_of(pose), triple_of(finite(normal, 3, "normal")),
                   {given[0], given[1], given[2], given[3], given[4], rounds});
    if (!found.found) return nb::none();
    return nb::make_tuple(found.depth, tuple_of(found.normal), tuple_of(found.point));
}

// How far a shape at `at` (4, 4) is from an object at `pose`, its own nearest point and the direction from there to the
// object's. Nothing where they overlap.
nb::object gap_of(const SolidShape& part, const Numbers& at, const Body& object, const Numbers& pose) {
    need(!object.empty(), "object");
    const Frame placed = frame_of(at), there = placed.inverse() * frame_of(pose);
    const Triple along = towards(part.own, object, there);
    const Separation gap = Nearest(part.own, object, there, along, std::numeric_limits<double>::max(), false).gap;
    if (!(gap.apart > 0.0) || !(gap.distance > 0.0)) return nb::none();
    return nb::make_tuple(gap.distance, tuple_of(placed.act(gap.mine)), tuple_of(placed.turn(gap.normal)));
}

// An object that a hand pushes: joints and parts, added one by one.
struct Push {
    Pushing own;
    std::size_t inputs = 0;

    // How it goes: shares of the way, `caged` [m], and counts, as in `PushSettings`.
    Push(double radius, Numbers settings, int most, int cuts) {
        const double* given = finite(settings, 7, "settings");
        need_number(radius, true, "radius");
        for (int i = 0; i < 7; ++i) need_number(given[i], true, "settings");
        need(most >= 0 && most <= 100000 && cuts >= 0 && cuts <= 1000, "most, cuts");
        own.radius = radius;
        own.settings = {given[0], given[1], given[2], given[3], given[4], given[5], given[6], most, cuts};
    }

    void add_joint(std::int64_t parent, std::int64_t input, Numbers frame, Numbers screw) {
        own.joints.push_back(make_joint(own.joints, parent, input, frame, screw));
        inputs = std::max(inputs, static_cast<std::size_t>(input) + 1);
    }

    void add_part(std::int64_t joint, Numbers frame, const SolidShape& shape) {
        own.parts.push_back({joint_of(own.joints, joint), frame_of(frame), shape.own});
    }

    // Where on the way it ends; `q` (n) and `pose` (4, 4) of the object are where it starts and where it ends.
    // `pushers` (p, 2): parts and fingers; `speeds` (p).
    double push(Written q, Numbers rate, Numbers last, Written pose, double at, Indices pushers, Numbers speeds,
                double friction) {
        const std::size_t n = q.size(), p = speeds.size();
        need(n >= inputs && rate.size() == n && last.size() == n, "q, rate, last");
        need(pushers.size() == 2 * p && pose.size() == 16 && !own.object.empty(), "pushers, pose, object");
        need_number(friction, false, "friction"), need_number(at, false, "at");
        finite(rate, n, "rate"), finite(last, n, "last"), finite(speeds, p, "speeds");
        for (const Written& one : {q, pose})
            need(std::all_of(one.data(), one.data() + one.size(), [](double value) { return std::isfinite(value); }),
                 "q, pose");
        std::vector<Pusher> each;
        for (std::size_t i = 0; i < p; ++i) {
            const std::int64_t part = pushers.data()[2 * i], finger = pushers.data()[2 * i + 1];
            need(part >= 0 && part < static_cast<std::int64_t>(own.parts.size()), "pushers");
            each.push_back({static_cast<int>(part), static_cast<int>(finger), speeds.data()[i]});
        }
        std::vector<double> joints(q.data(), q.data() + n);
        Frame there = frame_at(pose.data());
        own.push(joints, rate.data(), last.data(), there, at, each, friction);
        std::copy(joints.begin(), joints.end(), q.data());
        for (int i = 0; i < 3; ++i) {
            std::copy_n(there.R.begin() + 3 * i, 3, pose.data() + 4 * i);
            pose.data()[4 * i + 3] = there.t[i];
        }
        return at;
    }
};

// The object of what is given, and its contacts with a number of parts.
template <class Given>
Grasped grasped_of(const Given& given, std::size_t parts) {
    need_number(given.mass, true, "mass"), need_number(given.mu, false, "mu");
    need_number(given.torsion, false, "torsion");
    Grasped found;
    found.mass = given.mass, found.mu = given.mu, found.torsion = given.torsion;
    const double* own = finite(given.object, 15, "object");
    std::copy_n(own, 9, found.inertia.begin());
    found.centre = triple_of(own + 9), found.gravity = triple_of(own + 12);
    found.stiffness = finite(given.stiffness, parts, "stiffness");
    return found;
}

// How a hand closes, as pinograsp.contacts.bulk has it: commands (3, rows, n), gains (6, n), steps (4), and the
// object's inertia (3, 3), centre and gravity (5, 3).
struct ClosingGiven {
    Numbers commands, gains, object, stiffness, root;
    Indices steps;
    double step, mass, mu, torsion;
    bool on_table;

    ClosingCourse course(std::size_t n) const {
        ClosingCourse found;
        need(n > 0 && commands.size() % (3 * n) == 0 && commands.size() > 0, "commands");
        found.rows = commands.size() / (3 * n);
        need(steps.size() == 4, "steps");
        for (int i = 0; i < 4; ++i) need(steps.data()[i] >= 0 && steps.data()[i] <= 100000, "steps");
        found.steps = static_cast<int>(steps.data()[0]), found.freed = static_cast<int>(steps.data()[1]);
        found.complete = static_cast<int>(steps.data()[2]), found.settled = static_cast<int>(steps.data()[3]);
        need_number(step, true, "step");
        found.step = step;
        found.q = finite(commands, commands.size(), "commands");
        found.dq = found.q + found.rows * n, found.effort = found.dq + found.rows * n;
        found.soft = sized(gains, 6 * n, "gains"), found.soft_damping = found.soft + n;
        found.stiff = found.soft + 2 * n, found.damping = found.soft + 3 * n;
        found.inertia = found.soft + 4 * n, found.limit = found.soft + 5 * n;
        return found;
    }

    Grasped grasped(std::size_t parts) const {
        Grasped found = grasped_of(*this, parts);
        found.on_table = on_table, found.root = frame_of(root);
        return found;
    }
};

// How hands are told to hold an object: motors of joints (m, n), their gains (3, m), joints (4, n), steps (2), the
// object as in `ClosingGiven`, loads (l, 6).
struct CommandGiven {
    Numbers arms, gains, joints, object, stiffness, loads, bounds;
    Indices steps;
    double step, loaded, mass, mu, torsion;

    std::size_t motors() const { return gains.size() / 3; }

    ClosingCourse course(std::size_t n) const {
        ClosingCourse found;
        const std::size_t m = motors();
        need(gains.size() == 3 * m && arms.size() == m * n && joints.size() == 4 * n, "arms, gains, joints");
        need(steps.size() == 2, "steps");
        for (int i = 0; i < 2; ++i) need(steps.data()[i] >= 0 && steps.data()[i] <= 100000, "steps");
        need_number(step, true, "step"), need_number(loaded, true, "loaded");
        found.step = step, found.loaded = loaded, found.elliptic = true, found.motors = static_cast<int>(m);
        found.complete = static_cast<int>(steps.data()[0]), found.steps = static_cast<int>(steps.data()[1]);
        found.arms = finite(arms, m * n, "arms");
        found.soft = found.stiff = gains.data(), found.soft_damping = found.damping = gains.data() + m;
        found.limit = gains.data() + 2 * m;
        found.inertia = joints.data(), found.passive = found.inertia + n, found.lower = found.inertia + 2 * n,
        found.upper = found.inertia + 3 * n;
        return found;
    }
};

// A hand's joints and parts, and an object, added one by one.
struct Scene {
    TouchScene own;

    Scene(std::int64_t inputs, Numbers root, Numbers object) {
        need(inputs >= 0 && inputs <= 100000, "inputs");
        own.inputs = static_cast<int>(inputs);
        own.root = frame_of(root), own.object = frame_of(object);
    }

    void add_joint(std::int64_t parent, std::int64_t input, Numbers frame, Numbers screw, double mass, Numbers moment) {
        need(input < own.inputs, "input");
        own.joints.push_back(make_joint(own.joints, parent, input, frame, screw));
        need_number(mass, false, "mass");
        own.loads.push_back({mass, triple_of(finite(moment, 3, "moment"))});
    }

    void add_part(std::int64_t joint, Numbers frame, std::int64_t link, Numbers points, Numbers radii,
                  Numbers triangles) {
        need(link >= 0 && link <= static_cast<std::int64_t>(own.parts.size()), "link");
        need(points.size() + triangles.size() > 0, "points, triangles");
        PartOfHand part{joint_of(own.joints, joint), frame_of(frame), static_cast<int>(link), {}, {}};
        part.hull = points.size() > 0 ? Body(solid_of(points, radii)) : surface_of(triangles);
        if (points.size() > 0) part.surface = surface_of(triangles);
        own.parts.push_back(std::move(part));
    }

    int part_of(std::int64_t part) const {
        need(part >= 0 && part < static_cast<std::int64_t>(own.parts.size()), "part");
        return static_cast<int>(part);
    }

    void add_pair(std::int64_t one, std::int64_t other) { own.pairs.push_back({part_of(one), part_of(other)}); }

    void add_solid(Numbers points, Numbers radii) {
        need(points.size() > 0, "points");
        own.solids.emplace_back(solid_of(points, radii));
    }

    // The object's own surface, after its solids; without any it stands for them.
    void put(Numbers triangles) {
        own.surface = surface_of(triangles);
        if (own.solids.empty() && !own.surface.empty()) own.solids.push_back(own.surface);
    }

    // The object's convex hull.
    void enclose(Numbers points, Numbers radii) { own.hull = solid_of(points, radii); }

    // How many postures (N, n) there are, with the hand's root at roots (N, 4, 4).
    std::size_t postures_of(const Numbers& q, const Numbers& roots) const {
        const std::size_t count = roots.size() / 16;
        need(roots.size() == 16 * count && q.size() == count * own.inputs, "q, roots");
        finite(q, q.size(), "q"), finite(roots, roots.size(), "roots");
        need(!own.solids.empty(), "solids");
        return count;
    }

    std::unique_ptr<Touches> touch(Numbers q, Numbers roots, double tolerance, double lean, Numbers gravity) const {
        const std::size_t count = postures_of(q, roots);
        need_number(tolerance, false, "tolerance"), need_number(lean, false, "lean");
        const TouchOptions options{tolerance, lean, triple_of(finite(gravity, 3, "gravity"))};
        auto found = std::make_unique<Touches>();
        nb::gil_scoped_release released;
        Toucher toucher(own);
        for (std::size_t i = 0; i < count; ++i)
            toucher.touch(q.data() + i * own.inputs, frame_at(roots.data() + 16 * i), options, *found);
        return found;
    }

    // Fills gaps (N).
    void gaps(Numbers q, Numbers roots, Indices parts, double reach, Written gaps) const {
        const std::size_t count = postures_of(q, roots);
        need_number(reach, false, "reach"), need(gaps.size() == count, "gaps");
        std::vector<int> chosen;
        for (std::size_t i = 0; i < parts.size(); ++i) chosen.push_back(part_of(parts.data()[i]));
        nb::gil_scoped_release released;
        Toucher toucher(own);
        for (std::size_t i = 0; i < count; ++i)
            gaps.data()[i] = toucher.gap(q.data() + i * own.inputs, frame_at(roots.data() + 16 * i), chosen, reach);
    }

    // Closes the hand on the object at places (N, 4, 4) away from where it is planned; fills outcomes (N, 5).
    // Grasps of motors that are told `targets` (N, rows, m) from joints `start` (N, n), roots at (N, rows, 4, 4):
    // `farthest` (N, l, 2) and `pressed` (N, p), see Closer::command.
    void command(const CommandGiven& given, Numbers targets, Numbers start, Numbers roots, Written farthest,
                 Written pressed) const {
        const std::size_t n = own.inputs, m = given.motors(), p = own.parts.size(), l = given.loads.size() / 6;
        need(n > 0 && m > 0 && start.size() % n == 0, "start, gains");
        const std::size_t count = start.size() / n, rows = count ? targets.size() / (count * m) : 0;
        need(targets.size() == count * rows * m && roots.size() == count * rows * 16 && (rows > 0 || count == 0),
             "targets, roots");
        need(farthest.size() == count * l * 2 && pressed.size() == count * p, "farthest, pressed");
        finite(targets, targets.size(), "targets"), finite(start, start.size(), "start");
        finite(roots, roots.size(), "roots");
        need(!own.solids.empty() && !own.hull.empty(), "solids, hull");
        const double *loads = finite(given.loads, 6 * l, "loads"), *bounds = finite(given.bounds, 2, "bounds");
        ClosingCourse course = given.course(n);
        const Grasped grasped = grasped_of(given, p);
        const std::vector<double> still(rows * m, 0.0);
        course.rows = rows, course.dq = course.effort = still.data();
        nb::gil_scoped_release released;
        Closer closer(own, course, grasped);
        for (std::size_t i = 0; i < count; ++i) {
            course.q = targets.data() + i * rows * m, course.start = start.data() + i * n;
            course.roots = roots.data() + i * rows * 16;
            closer.command(loads, static_cast<int>(l), {bounds[0], bounds[1]}, farthest.data() + i * l * 2,
                           pressed.data() + i * p);
        }
    }

    void close(const ClosingGiven& given, Numbers places, Written outcomes) const {
        const std::size_t n = own.inputs, count = places.size() / 16;
        need(places.size() == 16 * count && outcomes.size() == 5 * count, "places, outcomes");
        finite(places, places.size(), "places");
        need(!own.solids.empty() && !own.hull.empty(), "solids, hull");
        const ClosingCourse course = given.course(n);
        const Grasped grasped = given.grasped(own.parts.size());
        nb::gil_scoped_release released;
        Closer closer(own, course, grasped);
        for (std::size_t i = 0; i < count; ++i) {
            const ClosingOutcome found = closer.close(frame_at(places.data() + 16 * i));
            double* to = outcomes.data() + 5 * i;
            to[0] = found.overlap, to[1] = found.moved, to[2] = found.turned, to[3] = found.crept;
            to[4] = found.pushed;
        }
    }

    // Fills placements (N, p, 4, 4), zeros before.
    void place(Numbers q, Numbers roots, Written placed) const {
        const std::size_t count = postures_of(q, roots);
        need(placed.size() == 16 * count * own.parts.size(), "placed");
        Toucher toucher(own);
        std::vector<Frame> frames;
        for (std::size_t i = 0; i < count; ++i)
            toucher.place(q.data() + i * own.inputs, frame_at(roots.data() + 16 * i), frames);
        double* to = placed.data();
        for (const Frame& frame : frames) {
            for (int i = 0; i < 3; ++i) {
                std::copy(frame.R.begin() + 3 * i, frame.R.begin() + 3 * i + 3, to);
                to[3] = frame.t[i], to += 4;
            }
            to[3] = 1.0, to += 4;
        }
    }
};

// The best of the modules that this processor runs.
const char* best_level() {
#ifdef PINOGRASP_CORE_X86_64
    const bool v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
                    __builtin_cpu_supports("bmi2");
    const bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                    __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
    return v4 ? "v4" : v3 ? "v3" : "base";
#else
    return "base";
#endif
}

}  // namespace

NB_MODULE(PINOGRASP_CORE_MODULE, m) {
    // Scenes and loops that callers keep until the interpreter ends are no leaks.
    nb::set_leak_warnings(false);
    m.attr("width") = width;
    m.def("best_level", &best_level);
    nb::class_<GraspSetup> grasp_setup(m, "GraspSetup");
    grasp_setup.def(nb::init<>())
        .def_rw("k", &GraspSetup::k)
        .def_rw("m", &GraspSetup::m)
        .def_rw("r", &GraspSetup::r)
        .def_rw("d", &GraspSetup::d)
        .def_rw("round", &GraspSetup::round)
        .def_rw("separates", &GraspSetup::separates)
        .def_rw("constant", &GraspSetup::constant)
        .def_rw("largest", &GraspSetup::largest)
        .def_rw("peak", &GraspSetup::peak)
        .def_rw("arm", &GraspSetup::arm)
        .def_rw("near", &GraspSetup::near);
    array_of(grasp_setup, "facets", &GraspSetup::facets);
    array_of(grasp_setup, "vertices", &GraspSetup::vertices);
    array_of(grasp_setup, "B", &GraspSetup::B);
    array_of(grasp_setup, "P", &GraspSetup::P);
    array_of(grasp_setup, "q", &GraspSetup::q);
    array_of(grasp_setup, "R_lo", &GraspSetup::R_lo);
    array_of(grasp_setup, "R_hi", &GraspSetup::R_hi);
    array_of(grasp_setup, "correction", &GraspSetup::correction);
    array_of(grasp_setup, "widths", &GraspSetup::widths);
    array_of(grasp_setup, "grasp_matrix", &GraspSetup::grasp_matrix);
    array_of(grasp_setup, "normals", &GraspSetup::normals);
    nb::class_<Forces>(m, "Grasp")
        .def(nb::new_(&grasp_from), "setup"_a)
        .def("bounds", &bounds, "b"_a, "lo"_a, "hi"_a, "R_lo"_a, "R_hi"_a, "P"_a, "q"_a, "terms"_a, "peak"_a, "x"_a,
             "y"_a)
        .def("answer", &answer, "newton"_a, "b"_a, "lo"_a, "hi"_a, "R_lo"_a, "R_hi"_a, "P"_a, "q"_a, "terms"_a,
             "peak"_a);
    nb::class_<Prepared>(m, "Prepared")
        .def(nb::init<nb::object, bool, Numbers, Numbers, Numbers, double, double, double, double, double>(), "grasp"_a,
             "newton"_a, "least"_a, "greatest"_a, "terms"_a, nb::kw_only(), "residual"_a, "violation"_a, "gap"_a,
             "vanishing"_a, "negligible"_a)
        .def("solve", &Prepared::solve, "load"_a.noconvert(), "numbers"_a, "active"_a)
        .def("prove", &Prepared::prove, "load"_a.noconvert(), "direction"_a, "numbers"_a, "active"_a);
    nb::class_<OnlineSetup> online_setup(m, "OnlineSetup");
    online_setup.def(nb::init<>())
        .def_rw("contacts", &OnlineSetup::contacts)
        .def_rw("components", &OnlineSetup::components)
        .def_rw("round", &OnlineSetup::round)
        .def_rw("moments", &OnlineSetup::moments)
        .def_rw("torsion", &OnlineSetup::torsion)
        .def_rw("arm", &OnlineSetup::arm)
        .def_rw("safety", &OnlineSetup::safety)
        .def_rw("ramp", &OnlineSetup::ramp)
        .def_rw("most_rate", &OnlineSetup::most_rate)
        .def_rw("most_steps", &OnlineSetup::most_steps)
        .def_rw("joints", &OnlineSetup::joints)
        .def_rw("limited", &OnlineSetup::limited)
        .def_rw("couplings", &OnlineSetup::couplings)
        .def_rw("stops", &OnlineSetup::stops)
        .def_rw("borne", &OnlineSetup::borne)
        .def_prop_rw(
            "links",
            [](const OnlineSetup& setup) {
                std::vector<std::array<int, 3>> found;
                for (const Link& link : setup.links) found.push_back({link.contact, link.column, link.joint});
                return found;
            },
            [](OnlineSetup& setup, const std::vector<std::array<int, 3>>& links) {
                setup.links.clear();
                for (const auto& link : links) setup.links.push_back({link[0], link[1], link[2]});
            });
    array_of(online_setup, "coupling_rows", &OnlineSetup::coupling_rows);
    array_of(online_setup, "coupled", &OnlineSetup::coupled);
    nb::class_<Loop> loop(m, "Loop");
    loop.def(nb::init<const OnlineSetup&>(), "setup"_a)
        .def("step", &Loop::step, "load"_a.noconvert())
        .def("hand", &Loop::hand, "jacobian"_a, "gravity"_a)
        .def("gravity", &Loop::gravity, "values"_a)
        .def("place", &Loop::place, "points"_a, "rotations"_a)
        .def("rub", &Loop::rub, "mu"_a)
        .def("reset", [](Loop& own) { own.online->reset(); })
        .def("engage", &Loop::engage, "contact"_a, "touches"_a, "at_once"_a)
        .def_prop_ro("steps", [](const Loop& own) { return own.online->steps; })
        .def_prop_ro("off", [](const Loop& own) { return own.online->off; });
    const auto array = [&loop](const char* name, double* Online::* values, int width_of) {
        loop.def_prop_ro(name, [values, width_of](nb::handle self) {
            Online& own = *nb::cast<Loop&>(self).online;
            return view_of(own.*values, width_of, own.setup().contacts, own.setup().joints, self);
        });
    };
    array("least", &Online::least, 1);
    array("largest", &Online::largest, 1);
    array("mu", &Online::mu, 1);
    array("points", &Online::points, 3);
    array("forces", &Online::forces, 3);
    array("moments", &Online::moments, 1);
    array("torques", &Online::torques, 0);
    array("torque_limit", &Online::torque_limit, 0);
    loop.def_prop_ro("rotations", [](nb::handle self) {
        Online& own = *nb::cast<Loop&>(self).online;
        return view(own.rotations, {static_cast<std::size_t>(own.setup().contacts), 3, 3}, self);
    });
    loop.def_prop_ro("residual",
                     [](nb::handle self) { return view(nb::cast<Loop&>(self).online->unbalanced, {6}, self); });
    loop.def_prop_ro("com", [](nb::handle self) { return view(nb::cast<Loop&>(self).online->com, {3}, self); });
    nb::class_<GripSetup> grip_setup(m, "GripSetup");
    grip_setup.def(nb::init<>())
        .def_rw("period", &GripSetup::period)
        .def_rw("latency", &GripSetup::latency)
        .def_rw("smoothing", &GripSetup::smoothing)
        .def_rw("noise", &GripSetup::noise)
        .def_rw("scale", &GripSetup::scale)
        .def_rw("margin", &GripSetup::margin)
        .def_rw("kept", &GripSetup::kept)
        .def_rw("unfelt", &GripSetup::unfelt)
        .def_rw("jump", &GripSetup::jump)
        .def_rw("calm", &GripSetup::calm)
        .def_rw("release", &GripSetup::release)
        .def_rw("blind", &GripSetup::blind)
        .def_rw("tells_load", &GripSetup::tells_load);
    const auto few = [&grip_setup](const char* name, auto field, std::size_t count) {
        grip_setup.def_prop_rw(
            name,
            [field, count](const GripSetup& setup) { return std::vector<double>(setup.*field, setup.*field + count); },
            [field, count, name](GripSetup& setup, const std::vector<double>& values) {
                need(values.size() == count, name);
                std::copy(values.begin(), values.end(), setup.*field);
            });
    };
    few("gravity", &GripSetup::gravity, 3);
    few("load", &GripSetup::load, 6);
    array_of(grip_setup, "planned", &GripSetup::planned);
    array_of(grip_setup, "grasp_map", &GripSetup::grasp_map);
    array_of(grip_setup, "internal", &GripSetup::internal);
    array_of(grip_setup, "joint_map", &GripSetup::joint_map);
    array_of(grip_setup, "from_torques", &GripSetup::from_torques);
    array_of(grip_setup, "bias", &GripSetup::bias);
    array_of(grip_setup, "torque_limit", &GripSetup::torque_limit);
    array_of(grip_setup, "most", &GripSetup::most);
    array_of(grip_setup, "mu", &GripSetup::mu);
    nb::class_<GripLoop> grip(m, "Grip");
    grip.def(nb::init<nb::object, const GripSetup&>(), "loop"_a, "setup"_a)
        .def("feel", &GripLoop::feel, "kind"_a, "values"_a, "time"_a)
        .def(
            "tick", [](GripLoop& own, double now) { return static_cast<int>(own.grip->tick(now)); }, "now"_a)
        .def("reset", [](GripLoop& own) { own.grip->reset(); })
        .def_prop_ro("mass", [](const GripLoop& own) { return own.grip->mass; })
        .def_prop_ro("load_bound", [](const GripLoop& own) { return own.grip->load_bound; })
        .def_prop_ro("reflexes", [](const GripLoop& own) { return own.grip->reflexes; })
        .def_prop_ro("blind", [](const GripLoop& own) { return own.grip->blind; });
    const auto told = [&grip](const char* name, double* Grip::* values, int width) {
        grip.def_prop_ro(name, [values, width](nb::handle self) {
            Grip& own = *nb::cast<GripLoop&>(self).grip;
            return view_of(own.*values, width, own.contacts(), own.joints(), self);
        });
    };
    told("forces", &Grip::forces, 3);
    told("torques", &Grip::torques, 0);
    told("mu", &Grip::mu, 1);
    told("mu_low", &Grip::mu_low, 1);
    told("mu_high", &Grip::mu_high, 1);
    told("slipping", &Grip::slipping, 1);
    grip.def_prop_ro("load", [](nb::handle self) { return view(nb::cast<GripLoop&>(self).grip->load, {6}, self); });
    nb::class_<Box>(m, "Box")
        .def(nb::new_(&make_box), "H"_a, "eps"_a, "fixed"_a, "row"_a)
        .def(
            "solve", [](Box& box, Wrench load) { return box.solve(load.data()); }, "load"_a)
        .def_prop_ro("k", [](nb::handle self) {
            Box& box = nb::cast<Box&>(self);
            return view(box.k.data(), {box.k.size()}, self);
        });
    nb::class_<Approach>(m, "Approach")
        .def(nb::init<double, double, double>(), nb::kw_only(), "touch"_a, "creep"_a, "near"_a)
        .def("add_joint", &Approach::add_joint, "parent"_a, "input"_a, "frame"_a, "screw"_a)
        .def("add_part", &Approach::add_part, "joint"_a, "frame"_a, "corners"_a, "points"_a, "radii"_a)
        .def(
            "put", [](Approach& own, Numbers points, Numbers radii) { own.way.object = solid_of(points, radii); },
            "points"_a, "radii"_a)
        .def("pursue", &Approach::pursue, "at"_a, "end"_a, "q"_a, "rate"_a, "object_pose"_a, "known"_a, "most"_a);
    nb::class_<Push>(m, "Push")
        .def(nb::init<double, Numbers, int, int>(), "radius"_a, "settings"_a, nb::kw_only(), "most"_a, "cuts"_a)
        .def("add_joint", &Push::add_joint, "parent"_a, "input"_a, "frame"_a, "screw"_a)
        .def("add_part", &Push::add_part, "joint"_a, "frame"_a, "shape"_a)
        .def(
            "put", [](Push& own, const SolidShape& shape) { own.own.object = shape.own; }, "shape"_a)
        .def(
            "put", [](Push& own, const Triangles& surface) { own.own.object = surface.tree(); }, "shape"_a)
        .def("push", &Push::push, "q"_a, "rate"_a, "last"_a, "pose"_a, "at"_a, "pushers"_a, "speeds"_a, "friction"_a);
    nb::class_<Touches> touches(m, "Touches");
    const auto numbers = [&touches](const char* name, std::vector<double> Touches::* values) {
        touches.def_prop_ro(name, [values](nb::handle self) {
            std::vector<double>& own = nb::cast<Touches&>(self).*values;
            return view(own.data(), {own.size()}, self);
        });
    };
    numbers("gap", &Touches::gap);
    numbers("points", &Touches::points);
    numbers("normals", &Touches::normals);
    numbers("corners", &Touches::corners);
    numbers("leaning", &Touches::leaning);
    numbers("jacobians", &Touches::jacobians);
    numbers("depth", &Touches::depth);
    numbers("gravity", &Touches::gravity);
    const auto indices = [&touches](const char* name, std::vector<std::int64_t> Touches::* values) {
        touches.def_prop_ro(name, [values](nb::handle self) { return view(nb::cast<Touches&>(self).*values, self); });
    };
    indices("grasp", &Touches::grasp);
    indices("part", &Touches::part);
    indices("counts", &Touches::counts);
    indices("collision", &Touches::collision);
    indices("failed", &Touches::failed);
    nb::class_<ClosingGiven>(m, "ClosingGiven")
        .def(
            "__init__",
            [](ClosingGiven* own, Numbers commands, Numbers gains, Numbers object, Numbers stiffness, Numbers root,
               Indices steps, double step, double mass, double mu, double torsion, bool on_table) {
                new (own)
                    ClosingGiven{commands, gains, object, stiffness, root, steps, step, mass, mu, torsion, on_table};
            },
            nb::kw_only(), "commands"_a, "gains"_a, "object"_a, "stiffness"_a, "root"_a, "steps"_a, "step"_a, "mass"_a,
            "mu"_a, "torsion"_a, "on_table"_a);
    nb::class_<CommandGiven>(m, "CommandGiven")
        .def(
            "__init__",
            [](CommandGiven* own, Numbers arms, Numbers gains, Numbers joints, Numbers object, Numbers stiffness,
               Numbers loads, Numbers bounds, Indices steps, double step, double loaded, double mass, double mu,
               double torsion) {
                new (own) CommandGiven{arms,  gains, joints, object, stiffness, loads,  bounds,
                                       steps, step,  loaded, mass,   mu,        torsion};
            },
            nb::kw_only(), "arms"_a, "gains"_a, "joints"_a, "object"_a, "stiffness"_a, "loads"_a, "bounds"_a, "steps"_a,
            "step"_a, "loaded"_a, "mass"_a, "mu"_a, "torsion"_a);
    nb::class_<Triangles>(m, "Triangles")
        .def(
            "__init__",
            [](Triangles* own, Numbers corners) {
                need(corners.size() % 9 == 0, "corners");
                new (own) Triangles(triples_of(corners, "corners"));
            },
            "corners"_a)
        .def(
            "find_nearest",
            // Of k points, into `surface` (k, 3) the nearest ones, and into `found` (k, 3) their triangles, features
            // and whether others are as near on the opposite side.
            [](Triangles& own, Numbers points, double alike, Written surface, WrittenIndices found) {
                need_number(alike, false, "alike");
                const std::vector<Triple> all = triples_of(points, "points");
                need(surface.size() == 3 * all.size() && found.size() == 3 * all.size(), "surface, found");
                need(!own.tree().empty(), "triangles");
                for (std::size_t i = 0; i < all.size(); ++i) {
                    const NearestTriangle one = own.find_nearest(all[i], alike);
                    need(one.triangle >= 0, "points");
                    std::copy(one.foot.at.begin(), one.foot.at.end(), surface.data() + 3 * i);
                    found.data()[3 * i] = one.triangle;
                    found.data()[3 * i + 1] = one.foot.feature, found.data()[3 * i + 2] = one.opposite;
                }
            },
            "points"_a, "alike"_a, "surface"_a, "found"_a);
    nb::class_<SolidShape>(m, "Shape")
        .def(nb::init<Numbers, Numbers, Numbers>(), "points"_a, "radii"_a, "triangles"_a)
        .def(
            "depth_in",
            [](const SolidShape& part, Numbers at, const SolidShape& object, Numbers pose, Numbers normal, Numbers how,
               int rounds) { return depth_of(part, at, object.own, pose, normal, how, rounds); },
            "at"_a, "object"_a, "pose"_a, "normal"_a, "how"_a, "rounds"_a)
        .def(
            "depth_in",
            [](const SolidShape& part, Numbers at, const Triangles& object, Numbers pose, Numbers normal, Numbers how,
               int rounds) { return depth_of(part, at, object.tree(), pose, normal, how, rounds); },
            "at"_a, "object"_a, "pose"_a, "normal"_a, "how"_a, "rounds"_a)
        .def(
            "gap_to",
            [](const SolidShape& part, Numbers at, const SolidShape& object, Numbers pose) {
                return gap_of(part, at, object.own, pose);
            },
            "at"_a, "object"_a, "pose"_a)
        .def(
            "gap_to",
            [](const SolidShape& part, Numbers at, const Triangles& object, Numbers pose) {
                return gap_of(part, at, object.tree(), pose);
            },
            "at"_a, "object"_a, "pose"_a);
    nb::class_<Scene>(m, "Scene")
        .def(nb::init<std::int64_t, Numbers, Numbers>(), "inputs"_a, "root"_a, "object_pose"_a)
        .def("add_joint", &Scene::add_joint, "parent"_a, "input"_a, "frame"_a, "screw"_a, "mass"_a, "moment"_a)
        .def("add_part", &Scene::add_part, "joint"_a, "frame"_a, "link"_a, "points"_a, "radii"_a, "triangles"_a)
        .def("add_pair", &Scene::add_pair, "one"_a, "other"_a)
        .def("add_solid", &Scene::add_solid, "points"_a, "radii"_a)
        .def("put", &Scene::put, "triangles"_a)
        .def("enclose", &Scene::enclose, "points"_a, "radii"_a)
        .def("touch", &Scene::touch, "q"_a, "roots"_a, nb::kw_only(), "tolerance"_a, "lean"_a, "gravity"_a)
        .def("gaps", &Scene::gaps, "q"_a, "roots"_a, "parts"_a, "reach"_a, "gaps"_a)
        .def("place", &Scene::place, "q"_a, "roots"_a, "placed"_a)
        .def("close", &Scene::close, "given"_a, "places"_a, "outcomes"_a)
        .def("command", &Scene::command, "given"_a, "targets"_a, "start"_a, "roots"_a, "farthest"_a, "pressed"_a);
    m.def("solve_batch", &batch, "start"_a, "stop"_a, nb::kw_only(), "components"_a, "round"_a, "rows"_a, "torsion"_a,
          "squares"_a, "points"_a, "rotations"_a, "counts"_a, "loads"_a, "mu"_a, "low"_a, "high"_a, "arms"_a, "terms"_a,
          "forces"_a, "moments"_a, "objective"_a, "lower_bound"_a, "residual"_a, "violation"_a, "codes"_a);
    m.def("find_least_mu", &least_mu, "start"_a, "stop"_a, nb::kw_only(), "components"_a, "round"_a, "torsion"_a,
          "most"_a, "within"_a, "points"_a, "rotations"_a, "counts"_a, "loads"_a, "low"_a, "high"_a, "arms"_a,
          "least"_a, "codes"_a);
    m.def("react", &react, "start"_a, "stop"_a, nb::kw_only(), "torsion"_a, "points"_a, "rotations"_a, "counts"_a,
          "arms"_a, "wrenches"_a, "change"_a, "borne"_a, "whole"_a = nb::none(), "whole_borne"_a = nb::none(),
          "capacities"_a = nb::none());
    m.def("find_offsets", &offsets, "start"_a, "stop"_a, nb::kw_only(), "change"_a, "borne"_a, "counts"_a, "rows"_a,
          "round"_a, "limits"_a, "facets"_a, "local"_a.none(), "shares"_a, "offsets"_a);
    m.def("find_multiples", &multiples, "start"_a, "stop"_a, nb::kw_only(), "change"_a, "borne"_a, "counts"_a, "rows"_a,
          "round"_a, "limits"_a, "facets"_a, "local"_a, "multiples"_a);
    m.def("find_efforts", &efforts, "start"_a, "stop"_a, nb::kw_only(), "change"_a, "borne"_a, "counts"_a, "rows"_a,
          "jacobians"_a, "places"_a, "rotations"_a, "bias"_a, "local"_a, "torques"_a, "most"_a);
}
