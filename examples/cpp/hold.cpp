// A 1 kHz loop that holds an object: the load changes, a contact is lost and comes back, joints have limits.
// grasp.hpp is what `plan.to_core("grasp.hpp", max_rate=200.0, ramp=0.1)` wrote. Usage: hold [seconds]
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include "grasp.hpp"

using Clock = std::chrono::steady_clock;

int main(int count, char** arguments) {
    const double seconds = count > 1 ? std::atof(arguments[1]) : 2.0;
    const int ticks = static_cast<int>(seconds / grasp::period);
    auto loop = grasp::make_loop();  // allocates all memory; the loop allocates none
    std::vector<double> spent(ticks);
    int held = 0;
    auto due = Clock::now();
    for (int t = 0; t < ticks; ++t) {
        std::this_thread::sleep_until(due);
        due += std::chrono::nanoseconds(static_cast<long>(1e9 * grasp::period));

        // What the object pulls at: here the load of the plan, and a tenth more or less. [N, N m]
        const double share = 1.0 + 0.1 * std::sin(6.2832 * t * grasp::period);
        for (int r = 0; r < 6; ++r) loop->wrench[r] = share * grasp::load[r];
        // Where the fingers are, from your model of the hand: Pinocchio's J (6, n) by columns, and gravity's torques.
        // loop->jacobian = data.J.data();  loop->gravity = data.g.data();
        if (t == ticks / 2) loop->engage(grasp::contacts - 1, false);  // a contact fades out within the ramp ...
        if (t == ticks * 3 / 4) loop->engage(grasp::contacts - 1);     // ... and comes back

        const auto before = Clock::now();
        const auto status = loop->tick();
        spent[t] = std::chrono::duration<double, std::micro>(Clock::now() - before).count();
        held += status == pinograsp::core::Tick::converged;

        // Send loop->torques (joints) to the hand. Not held: they give the forces that come closest.
        if (t % std::max(1, ticks / 8) == 0) {
            std::printf("%6.3f s  F_n", t * grasp::period);
            for (int i = 0; i < grasp::contacts; ++i) std::printf(" %7.3f", loop->forces[3 * i + 2]);
            std::printf(" N  %s  off by %.1e N\n", status == pinograsp::core::Tick::converged ? "held  " : "closest", loop->off);
        }
    }
    std::sort(spent.begin(), spent.end());
    const auto at = [&](double share) { return spent[std::min(ticks - 1, static_cast<int>(share * ticks))]; };
    std::printf("held in %d of %d ticks; a tick takes %.2f us, 99.9 %%: %.2f, worst %.2f\n", held, ticks, at(0.5), at(0.999),
                spent.back());
}
