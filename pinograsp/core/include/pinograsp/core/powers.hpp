// Powers of F_n in the objective.
#pragma once

#include "problem.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// phi, phi' and phi''.
template <class V>
struct Phi {
    V value, first, second;
};

// At F >= 0, from one logarithm and one exponential for each power; coefficients and exponents are numbers, or those of
// the lanes.
template <class V, class C>
PINOGRASP_INLINE Phi<V> phi(V F, int count, const C* coefficients, const C* exponents) {
    Phi<V> found{0.0, 0.0, 0.0};
    const V at = max(F, V(1e-300));
    const V logarithm = log(at);
    for (int a = 0; a < count; ++a) {
        const V exponent = exponents[a], power = V(coefficients[a]) * exp(exponent * logarithm);
        found.value = found.value + power / (V(1.0) + exponent);
        found.first = found.first + power;
        found.second = found.second + exponent * power;
    }
    found.value = found.value * at;
    found.second = found.second / at;
    return found;
}

// phi' from pairs (coefficient, exponent) of powers of F_n in newtons, for forces over `scale` and objectives over
// `unit`; equal exponents are added up. False: there are too many.
inline bool powers_of(const double* terms, int count, double scale, double unit, Powers& out) {
    out.count = 0;
    for (int t = 0; t < count; ++t) {
        const double coefficient = terms[2 * t], exponent = terms[2 * t + 1];
        int a = 0;
        while (a < out.count && out.exponents[a] != exponent - 1.0) ++a;
        if (a == most_powers) return false;
        if (a == out.count) {
            out.exponents[a] = exponent - 1.0;
            out.coefficients[a] = 0.0;
            ++out.count;
        }
        out.coefficients[a] += coefficient * exponent * std::pow(scale, exponent) / unit;
    }
    return true;
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
