// What the core's records refuse, and answers that are known by hand: two contacts that hold a weight by friction.
#include <cmath>
#include <cstdio>
#include <functional>
#include <string>
#include <vector>

#include <pinograsp/core.hpp>

using namespace pinograsp::core;

namespace {

int failures = 0;

void check(bool holds, const std::string& what) {
    if (holds) return;
    std::printf("failed: %s\n", what.c_str());
    ++failures;
}

void check_near(double found, double expected, double within, const std::string& what) {
    check(std::fabs(found - expected) <= within,
          what + ": expected " + std::to_string(expected) + ", got " + std::to_string(found));
}

// Jaws along x, 60 mm apart, friction 0.5, that hold 1 N. Each contact bears half of it, at the edge of its cone:
// F_n = 0.5 / 0.5 = 1 N, and the sum of squares is 2 (1 + 0.25).
constexpr double half = 0.03, friction = 0.5, weight = 1.0;
constexpr double points[2][3] = {{half, 0.0, 0.0}, {-half, 0.0, 0.0}};
constexpr double rotations[2][9] = {{0, 0, -1, 1, 0, 0, 0, -1, 0}, {0, 0, 1, 1, 0, 0, 0, 1, 0}};
constexpr double nan = __builtin_nan("");

OnlineSetup jaws() {
    OnlineSetup setup;
    setup.contacts = 2;
    setup.arm = half;
    return setup;
}

std::unique_ptr<Online> loop_of(const OnlineSetup& setup, double most = 100.0) {
    auto loop = make_online(setup);
    for (int i = 0; i < 2; ++i) {
        std::copy_n(points[i], 3, loop->points + 3 * i);
        std::copy_n(rotations[i], 9, loop->rotations + 9 * i);
        loop->mu[i] = friction;
        loop->least[i] = 0.0;
        loop->largest[i] = most;
    }
    loop->wrench[2] = -weight;
    return loop;
}

// The same grasp for `Forces`: components are in units of the friction cone, tangential ones by the coefficient.
GraspSetup grasp() {
    GraspSetup setup;
    const int k = setup.k = 2, m = setup.m, d = setup.d, n = d * k;
    setup.separates = true;
    setup.arm = half;
    setup.B.assign(m * n, 0.0);
    setup.P.assign(d * n, 0.0);
    setup.q.assign(n, 0.0);
    setup.widths.assign(n, 1.0);
    setup.grasp_matrix.assign(18 * k, 0.0);
    for (int i = 0; i < k; ++i)
        for (int j = 0; j < d; ++j) {
            const double width = j < 2 ? friction : 1.0;
            setup.widths[j * k + i] = width;
            setup.P[(j * d + j) * k + i] = 2.0 * width * width;
            double axis[3];
            for (int a = 0; a < 3; ++a) axis[a] = rotations[i][3 * a + j];
            const double* p = points[i];
            const double column[6] = {axis[0],
                                      axis[1],
                                      axis[2],
                                      p[1] * axis[2] - p[2] * axis[1],
                                      p[2] * axis[0] - p[0] * axis[2],
                                      p[0] * axis[1] - p[1] * axis[0]};
            for (int row = 0; row < m; ++row) {
                setup.B[row * n + j * k + i] = width * (row < 3 ? column[row] : column[row] / setup.arm);
                setup.grasp_matrix[(row * k + i) * 3 + j] = column[row];
            }
        }
    setup.correction.assign(n * m, 0.0);  // the balance as it is found
    for (int i = 0; i < k; ++i)
        for (int a = 0; a < 3; ++a) setup.normals.push_back(rotations[i][3 * a + 2]);
    setup.largest = 2.0;
    return setup;
}

void grasps_with_a_fault() {
    check(fault_of(grasp()) == nullptr, "a grasp without a fault");
    check(make_forces(GraspSetup()) == nullptr, "no grasp without contacts");
    const struct {
        const char* name;
        std::function<void(GraspSetup&)> spoil;
    } faults[] = {{"k", [](GraspSetup& own) { own.k = 0; }},
                  {"k", [](GraspSetup& own) { own.k = 2147483647; }},
                  {"m", [](GraspSetup& own) { own.m = 4; }},
                  {"r", [](GraspSetup& own) { own.r = -1; }},
                  {"d, round", [](GraspSetup& own) { own.d = 5; }},
                  {"vertices", [](GraspSetup& own) { own.round = 0; }},
                  {"facets", [](GraspSetup& own) { own.facets = {1.0}; }},
                  {"B", [](GraspSetup& own) { own.B.pop_back(); }},
                  {"B", [](GraspSetup& own) { own.B[3] = nan; }},
                  {"P", [](GraspSetup& own) { own.P[0] = infinity; }},
                  {"q", [](GraspSetup& own) { own.q.push_back(0.0); }},
                  {"R_lo", [](GraspSetup& own) { own.R_lo = {0.0}; }},
                  {"correction", [](GraspSetup& own) { own.correction.clear(); }},
                  {"widths", [](GraspSetup& own) { own.widths[0] = nan; }},
                  {"grasp_matrix", [](GraspSetup& own) { own.grasp_matrix.resize(18); }},
                  {"normals", [](GraspSetup& own) { own.normals[5] = -infinity; }},
                  {"constant", [](GraspSetup& own) { own.constant = -1.0; }},
                  {"largest", [](GraspSetup& own) { own.largest = nan; }},
                  {"arm", [](GraspSetup& own) { own.arm = 0.0; }},
                  {"near", [](GraspSetup& own) { own.near = -1e-6; }}};
    for (const auto& one : faults) {
        GraspSetup spoilt = grasp();
        one.spoil(spoilt);
        const char* found = fault_of(spoilt);
        check(found != nullptr && std::string(found) == one.name, std::string("the fault ") + one.name);
        check(make_forces(spoilt) == nullptr, std::string("no grasp with the fault ") + one.name);
    }
    GraspSetup crossed = grasp();
    crossed.r = 1;
    crossed.B.resize(7 * 6, 0.0);
    crossed.R_lo = {1.0};
    crossed.R_hi = {0.0};
    check(std::string(fault_of(crossed)) == "R_lo, R_hi", "torque limits that cross");
}

void loops_with_a_fault() {
    check(fault_of(jaws()) == nullptr, "a loop without a fault");
    const struct {
        const char* name;
        std::function<void(OnlineSetup&)> spoil;
    } faults[] = {{"contacts", [](OnlineSetup& own) { own.contacts = 2147483647; }},
                  {"components, round", [](OnlineSetup& own) { own.round = 1; }},
                  {"torsion", [](OnlineSetup& own) { own.torsion = -1.0; }},
                  {"arm", [](OnlineSetup& own) { own.arm = 1e-300; }},
                  {"safety", [](OnlineSetup& own) { own.safety = infinity; }},
                  {"ramp", [](OnlineSetup& own) { own.ramp = 2.0; }},
                  {"most_rate", [](OnlineSetup& own) { own.most_rate = nan; }},
                  {"most_steps", [](OnlineSetup& own) { own.most_steps = 0; }},
                  {"joints", [](OnlineSetup& own) { own.joints = -1; }},
                  {"links", [](OnlineSetup& own) { own.links = {{0, 0, 0}}; }},
                  {"limited", [](OnlineSetup& own) { own.limited = {1000000}; }},
                  {"coupled", [](OnlineSetup& own) { own.couplings = 1; }},
                  {"coupling_rows", [](OnlineSetup& own) { own.coupling_rows = {1.0}; }},
                  {"borne", [](OnlineSetup& own) { own.borne = 1.5; }}};
    for (const auto& one : faults) {
        OnlineSetup spoilt = jaws();
        one.spoil(spoilt);
        const char* found = fault_of(spoilt);
        check(found != nullptr && std::string(found) == one.name, std::string("the loop's fault ") + one.name);
        check(make_online(spoilt) == nullptr, std::string("no loop with the fault ") + one.name);
    }
}

void jaws_hold_a_weight_by_friction() {
    auto loop = loop_of(jaws());
    check(loop->tick() == Tick::converged, "the jaws hold the weight");
    for (int i = 0; i < 2; ++i) {
        check_near(loop->forces[3 * i + 2], weight / (2.0 * friction), 1e-7, "F_n of the loop");
        check_near(std::hypot(loop->forces[3 * i], loop->forces[3 * i + 1]), weight / 2.0, 1e-7, "F_t of the loop");
    }
    check_near(loop->off, 0.0, 1e-9, "what the loop leaves over");

    auto forces = make_forces(grasp());
    const double least[2] = {}, most[2] = {10.0, 10.0}, load[6] = {0.0, 0.0, -weight, 0.0, 0.0, 0.0};
    double wrench[6], components[6], torsion[2];
    bool at_friction[2], at_least[2], at_most[2];
    const Record record{wrench, components, torsion, at_friction, at_least, at_most, nullptr};
    for (bool newton : {true, false}) {
        const Certificate sure(forces->solve(newton, least, most, nullptr, 0, load, record), Tolerance());
        check(sure.optimal, newton ? "certified by Newton's method" : "certified by interior points");
        check_near(sure.objective, 2.5, 1e-6, "the sum of squares");
        check(sure.lower_bound <= sure.objective, "its lower bound");
        for (int i = 0; i < 2; ++i) {
            check_near(components[3 * i + 2], 1.0, 1e-6, "F_n of the grasp");
            check(at_friction[i] && !at_least[i] && !at_most[i], "friction is the limit that is reached");
        }
    }
}

void what_cannot_be_held_is_proven_so() {
    auto loop = loop_of(jaws(), 0.9);
    check(loop->tick() == Tick::infeasible, "0.9 N a jaw do not hold 1 N with friction 0.5");
    check_near(loop->off, 0.1, 1e-6, "what is left over: 1 - 2 0.5 0.9");
    auto forces = make_forces(grasp());
    const double least[2] = {}, most[2] = {0.9, 0.9}, b[6] = {0.0, 0.0, weight, 0.0, 0.0, 0.0};
    const GraspSetup setup = grasp();
    const Problem problem = forces->problem(b, least, most, nullptr, nullptr, setup.P.data(), setup.q.data());
    for (bool newton : {true, false}) {
        check(forces->answer(newton, problem).code == Code::infeasible, "no forces within 0.9 N");
        check(excluded(problem, forces->y()) > 0.0, "multipliers that prove it");
    }
}

void ticks_that_nothing_can_be_made_of_change_nothing() {
    auto loop = loop_of(jaws());
    loop->tick();
    const double before = loop->forces[2];
    loop->wrench[0] = nan;
    check(loop->tick() == Tick::unusable, "a load that is no number");
    check(loop->forces[2] == before, "the forces stay");
    loop->wrench[0] = 0.0;
    check(loop->tick() == Tick::converged, "the next tick");
}

void forces_change_no_faster_than_asked() {
    OnlineSetup setup = jaws();
    setup.most_rate = 0.01;
    auto loop = loop_of(setup);
    loop->tick();
    double before = loop->forces[2];
    loop->wrench[2] = -2.0 * weight;
    for (int t = 0; t < 150; ++t) {
        loop->tick();
        check(loop->forces[2] - before <= 0.01 + 1e-9, "the rate of F_n");
        before = loop->forces[2];
    }
    check_near(before, 2.0, 1e-6, "F_n of twice the weight, in the end");
}

}  // namespace

int main() {
    grasps_with_a_fault();
    loops_with_a_fault();
    jaws_hold_a_weight_by_friction();
    what_cannot_be_held_is_proven_so();
    ticks_that_nothing_can_be_made_of_change_nothing();
    forces_change_no_faster_than_asked();
    if (failures == 0) std::printf("all checks hold\n");
    return failures != 0;
}
