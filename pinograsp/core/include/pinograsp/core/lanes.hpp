// Several numbers at once, in one register of the processor: "lanes".
//
// Two uses: the contacts of one problem side by side, whose sums are numbers (S = double), or many problems side by
// side, whose sums are lanes themselves (S = Vector). Code that is written with `select`, `any` and `sum_to` serves
// both.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>

#if defined(__GNUC__) || defined(__clang__)
#define PINOGRASP_INLINE inline __attribute__((always_inline))
#else
#define PINOGRASP_INLINE inline
#endif

// 0: lanes of one number each, for compilers without vectors.
#ifndef PINOGRASP_VECTORS
#if defined(__GNUC__) || defined(__clang__)
#define PINOGRASP_VECTORS 1
#else
#define PINOGRASP_VECTORS 0
#endif
#endif

// Before loops of a few rounds whose number is known: their indices then cost nothing.
#if defined(__clang__)
#define PINOGRASP_UNROLL _Pragma("unroll")
#elif defined(__GNUC__)
#define PINOGRASP_UNROLL _Pragma("GCC unroll 8")
#else
#define PINOGRASP_UNROLL
#endif

// The same headers compiled for several kinds of processors in one program must not share their functions.
#ifndef PINOGRASP_CORE_LEVEL
#define PINOGRASP_CORE_LEVEL plain
#endif

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

#if PINOGRASP_VECTORS
#if defined(__AVX512F__)
constexpr int width = 8;
#elif defined(__AVX__)
constexpr int width = 4;
#else
constexpr int width = 2;
#endif

typedef double Doubles __attribute__((vector_size(8 * width)));
typedef std::int64_t Integers __attribute__((vector_size(8 * width)));

// True (all bits) or false in each lane.
struct Mask {
    Integers m;
};

struct Vector {
    Doubles v;
    Vector() = default;
    PINOGRASP_INLINE Vector(Doubles own) : v(own) {}
    PINOGRASP_INLINE Vector(double one) : v(Doubles{} + one) {}
};

PINOGRASP_INLINE Vector operator+(Vector a, Vector b) { return a.v + b.v; }
PINOGRASP_INLINE Vector operator-(Vector a, Vector b) { return a.v - b.v; }
PINOGRASP_INLINE Vector operator*(Vector a, Vector b) { return a.v * b.v; }
PINOGRASP_INLINE Vector operator/(Vector a, Vector b) { return a.v / b.v; }
PINOGRASP_INLINE Vector operator-(Vector a) { return -a.v; }
PINOGRASP_INLINE Mask operator<(Vector a, Vector b) { return {a.v < b.v}; }
PINOGRASP_INLINE Mask operator>(Vector a, Vector b) { return {a.v > b.v}; }
PINOGRASP_INLINE Mask operator<=(Vector a, Vector b) { return {a.v <= b.v}; }
PINOGRASP_INLINE Mask operator>=(Vector a, Vector b) { return {a.v >= b.v}; }
PINOGRASP_INLINE Mask operator==(Vector a, Vector b) { return {a.v == b.v}; }
PINOGRASP_INLINE Mask operator&(Mask a, Mask b) { return {a.m & b.m}; }
PINOGRASP_INLINE Mask operator|(Mask a, Mask b) { return {a.m | b.m}; }
PINOGRASP_INLINE Mask operator!(Mask a) { return {~a.m}; }

PINOGRASP_INLINE Vector select(Mask which, Vector a, Vector b) { return which.m ? a.v : b.v; }
PINOGRASP_INLINE Vector select(bool which, Vector a, Vector b) { return which ? a : b; }
PINOGRASP_INLINE Vector max(Vector a, Vector b) { return a.v > b.v ? a.v : b.v; }
PINOGRASP_INLINE Vector min(Vector a, Vector b) { return a.v < b.v ? a.v : b.v; }
PINOGRASP_INLINE Vector abs(Vector a) { return max(a, -a); }
PINOGRASP_INLINE Vector sqrt(Vector a) {
    Doubles root{};
    for (int l = 0; l < width; ++l) root[l] = __builtin_sqrt(a.v[l]);
    return root;
}
PINOGRASP_INLINE bool any(Mask which) {
    std::int64_t found = 0;
    for (int l = 0; l < width; ++l) found |= which.m[l];
    return found != 0;
}
PINOGRASP_INLINE bool lane_of(Mask which, int lane) { return which.m[lane] != 0; }
PINOGRASP_INLINE double sum(Vector a) {
    if constexpr (width == 8) {
        typedef double Half __attribute__((vector_size(32)));
        typedef double Quarter __attribute__((vector_size(16)));
        Half low, high;
        std::memcpy(&low, &a.v, 32);
        std::memcpy(&high, reinterpret_cast<const char*>(&a.v) + 32, 32);
        low += high;
        Quarter first, second;
        std::memcpy(&first, &low, 16);
        std::memcpy(&second, reinterpret_cast<const char*>(&low) + 16, 16);
        first += second;
        return first[0] + first[1];
    } else {
        double total = a.v[0];
        for (int l = 1; l < width; ++l) total += a.v[l];
        return total;
    }
}
PINOGRASP_INLINE double largest(Vector a) {
    double found = a.v[0];
    for (int l = 1; l < width; ++l) found = found > a.v[l] ? found : a.v[l];
    return found;
}
#else
constexpr int width = 1;
using Vector = double;
using Mask = bool;
#endif

// Plain numbers in the same words.
PINOGRASP_INLINE double select(bool which, double a, double b) { return which ? a : b; }
PINOGRASP_INLINE double max(double a, double b) { return a > b ? a : b; }
PINOGRASP_INLINE double min(double a, double b) { return a < b ? a : b; }
PINOGRASP_INLINE double abs(double a) { return std::fabs(a); }
PINOGRASP_INLINE double sqrt(double a) { return std::sqrt(a); }
PINOGRASP_INLINE bool any(bool which) { return which; }
PINOGRASP_INLINE bool lane_of(bool which, int) { return which; }
#if !PINOGRASP_VECTORS
PINOGRASP_INLINE double sum(double a) { return a; }
PINOGRASP_INLINE double largest(double a) { return a; }
#endif

// Sums and maxima over contacts as S: of contacts side by side they are numbers, of problems side by side they are not.
template <class S>
PINOGRASP_INLINE S sum_to(Vector a) {
    if constexpr (std::is_same_v<S, Vector>)
        return a;
    else
        return sum(a);
}
template <class S>
PINOGRASP_INLINE S largest_to(Vector a) {
    if constexpr (std::is_same_v<S, Vector>)
        return a;
    else
        return largest(a);
}

// A number of one lane; those of an array, one after the other.
PINOGRASP_INLINE double* numbers(Vector* array) { return reinterpret_cast<double*>(array); }
PINOGRASP_INLINE const double* numbers(const Vector* array) { return reinterpret_cast<const double*>(array); }
PINOGRASP_INLINE double& in_lane(Vector& vector, int lane) { return numbers(&vector)[lane]; }
PINOGRASP_INLINE double in_lane(const Vector& vector, int lane) { return numbers(&vector)[lane]; }

// The next `width` numbers.
PINOGRASP_INLINE Vector lanes_at(const double* from) {
    Vector found;
    std::memcpy(&found, from, sizeof found);
    return found;
}

PINOGRASP_INLINE void store(Vector a, double* into) { std::memcpy(into, &a, sizeof a); }

// The largest of all lanes.
inline double most_of(Vector a) {
    double own[width];
    store(a, own);
    for (int half = width / 2; half > 0; half /= 2)
        for (int l = 0; l < half; ++l) own[l] = own[l] > own[l + half] ? own[l] : own[l + half];
    return own[0];
}

// Blocks of `width` that hold a number of contacts, rows or columns.
constexpr int blocks_of(int count) { return (count + width - 1) / width; }

PINOGRASP_INLINE Vector clamp(Vector a, Vector least, Vector most) { return min(max(a, least), most); }

#if PINOGRASP_VECTORS
// The polynomial with these coefficients, that of the highest power first.
template <int N>
PINOGRASP_INLINE Doubles polynomial(Doubles x, const double (&coefficients)[N]) {
    Doubles total = Doubles{} + coefficients[0];
    for (int i = 1; i < N; ++i) total = total * x + coefficients[i];
    return total;
}

// Natural logarithm of positive normal numbers, to about 1e-16 of 1 + |log|: mantissa in [sqrt(1/2), sqrt(2)), and
// 2 atanh((m - 1) / (m + 1)) as a series.
PINOGRASP_INLINE Vector log(Vector a) {
    Integers bits;
    std::memcpy(&bits, &a.v, sizeof bits);
    Integers exponent = ((bits >> 52) & 0x7ff) - 1022;
    bits = (bits & 0x000fffffffffffff) | 0x3fe0000000000000;  // in [1/2, 1)
    Doubles m;
    std::memcpy(&m, &bits, sizeof m);
    const Integers low = m < 0.70710678118654752;
    m = low ? m + m : m;
    exponent += low;  // true is -1
    Doubles e{};
    for (int l = 0; l < width; ++l) e[l] = static_cast<double>(exponent[l]);
    const Doubles t = (m - 1.0) / (m + 1.0), s = t * t;
    const Doubles p = polynomial(s, {2.0 / 23.0, 2.0 / 21.0, 2.0 / 19.0, 2.0 / 17.0, 2.0 / 15.0, 2.0 / 13.0, 2.0 / 11.0,
                                     2.0 / 9.0, 2.0 / 7.0, 2.0 / 5.0, 2.0 / 3.0});
    const Doubles small = t * s * p + (t + t);
    return e * 0.693147180369123816490 + (e * 1.90821492927058770002e-10 + small);
}

// Exponential, to about 1e-16 of its value; below exp(-700) it is zero, above exp(700) as there.
PINOGRASP_INLINE Vector exp(Vector a) {
    Doubles x = clamp(a, -700.0, 700.0).v;
    const Doubles shift = Doubles{} + 6755399441055744.0;  // 1.5 2^52: adding it rounds
    const Doubles rounded = x * 1.4426950408889634 + shift;
    Integers n;
    std::memcpy(&n, &rounded, sizeof n);
    const Doubles whole = rounded - shift;
    const Doubles r = (x - whole * 0.693147180369123816490) - whole * 1.90821492927058770002e-10;
    const Doubles p =
        polynomial(r, {1.0 / 6227020800.0, 1.0 / 479001600.0, 1.0 / 39916800.0, 1.0 / 3628800.0, 1.0 / 362880.0,
                       1.0 / 40320.0, 1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0});
    const Integers power = (n << 52) + 0x3ff0000000000000;
    Doubles scale;
    std::memcpy(&scale, &power, sizeof scale);
    return select(a < Vector(-700.0), Vector(0.0), Vector(p * scale));
}
#else
PINOGRASP_INLINE double log(double a) { return std::log(a); }
PINOGRASP_INLINE double exp(double a) { return std::exp(a); }
#endif

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
