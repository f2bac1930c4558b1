// Ticks of a grasp, each timed by itself: `loop TICKS`, with grasp.hpp beside it and postures.bin, what Pinocchio
// gave: Jacobians (6 n) and gravity torques (n) one after the other. Built and run by loop.py.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <vector>

#include "grasp.hpp"

int main(int, char** arguments) {
    const long ticks = std::atol(arguments[1]);
    std::ifstream file("postures.bin", std::ios::binary);
    const std::vector<char> bytes{std::istreambuf_iterator<char>(file), {}};
    const double* postures = reinterpret_cast<const double*>(bytes.data());
    const int n = grasp::joints;
    const long count = static_cast<long>(bytes.size() / sizeof(double)) / (7 * n);
    auto loop = grasp::make_loop();
    std::vector<float> spent(ticks);
    long held = 0, steps = 0;
    for (long t = 0; t < ticks; ++t) {
        const double* here = postures + 7 * n * (t % count);
        loop->jacobian = here;
        loop->gravity = here + 6 * n;
        const double share = 1.0 + 0.2 * std::sin(0.01 * t) + 0.1 * std::sin(0.0237 * t);
        const auto before = std::chrono::steady_clock::now();
        for (int r = 0; r < 6; ++r) loop->wrench[r] = share * grasp::load[r];
        held += loop->tick() == pinograsp::core::Tick::converged;
        spent[t] = std::chrono::duration<float, std::micro>(std::chrono::steady_clock::now() - before).count();
        steps += loop->steps;
    }
    std::sort(spent.begin(), spent.end());
    const auto at = [&](double share) { return spent[static_cast<long>(share * (ticks - 1))]; };
    std::printf("%.3f %.3f %.3f %.3f %ld %.3f\n", at(0.5), at(0.99), at(0.999), at(1.0), held,
                static_cast<double>(steps) / ticks);
}
