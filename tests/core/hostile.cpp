// Hostile inputs for the core: whatever the numbers are, it does not crash, takes no memory while it solves, and what
// it calls solved is.
//
// Bytes become sizes and numbers. About half of the problems are reasonable grasps, the others are degenerate (contacts
// that coincide or lie on a line, no friction, no room between the limits, tiny and large loads), miss their limits by
// a percent, or have numbers in them that are none. Usage: hostile seed count [seconds]; input i of a run is
// `hostile <seed + i> 1`. With WITH_LIBFUZZER the fuzzer of clang gives the bytes.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>
#include <new>
#include <random>
#include <string>
#include <vector>

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define WITH_SANITIZER 1
#endif
#elif defined(__SANITIZE_ADDRESS__)
#define WITH_SANITIZER 1
#endif
#ifdef WITH_SANITIZER
#include <sanitizer/common_interface_defs.h>
#endif

#include "pinograsp/core.hpp"

using namespace pinograsp::core;

// -- memory that is taken ---------------------------------------------------------------------------------------------

static std::size_t taken = 0;  // how often

[[maybe_unused]] static void* take(std::size_t bytes, std::size_t alignment) {
    ++taken;
    const std::size_t room = std::max<std::size_t>(bytes, 1);
    void* found = alignment > alignof(std::max_align_t)
                      ? std::aligned_alloc(alignment, (room + alignment - 1) / alignment * alignment)
                      : std::malloc(room);
    if (found == nullptr) std::abort();
    return found;
}

// The fuzzer has its own.
#ifndef WITH_LIBFUZZER
// A call, so that compilers do not compare new with free.
__attribute__((noinline)) static void give(void* p) { std::free(p); }

void* operator new(std::size_t bytes) { return take(bytes, 1); }
void* operator new[](std::size_t bytes) { return take(bytes, 1); }
void* operator new(std::size_t bytes, std::align_val_t at) { return take(bytes, static_cast<std::size_t>(at)); }
void* operator new[](std::size_t bytes, std::align_val_t at) { return take(bytes, static_cast<std::size_t>(at)); }
void operator delete(void* p) noexcept { give(p); }
void operator delete[](void* p) noexcept { give(p); }
void operator delete(void* p, std::size_t) noexcept { give(p); }
void operator delete[](void* p, std::size_t) noexcept { give(p); }
void operator delete(void* p, std::align_val_t) noexcept { give(p); }
void operator delete[](void* p, std::align_val_t) noexcept { give(p); }
void operator delete(void* p, std::size_t, std::align_val_t) noexcept { give(p); }
void operator delete[](void* p, std::size_t, std::align_val_t) noexcept { give(p); }
#endif

namespace {

using Numbers = std::vector<double>;

constexpr double none = std::numeric_limits<double>::quiet_NaN();

// -- what is found ----------------------------------------------------------------------------------------------------

// By what was called: converged, stalled, infeasible, unusable.
struct Counts {
    const char* name;
    long long at[4] = {};
};
Counts ticks{"ticks"}, answers{"answers"}, solved{"solves"}, batched{"problems of batches"},
    searched{"least friction"}, boxes{"boxes"};
long long refused = 0, compared = 0, borderline = 0, certified = 0, proofs = 0, proven_loads = 0;
unsigned long long input = 0;  // its seed
std::string place;             // what is being done

void tell() { std::fprintf(stderr, "hostile: input %llu, %s\n", input, place.c_str()); }

[[noreturn]] __attribute__((format(printf, 1, 2))) void fail(const char* format, ...) {
    std::va_list values;
    va_start(values, format);
    std::fputs("hostile: ", stderr);
    std::vfprintf(stderr, format, values);
    std::fputc('\n', stderr);
    va_end(values);
    tell();
    std::abort();
}

// Calls that must not take memory.
template <class Call>
auto without_memory(const char* name, Call call) {
    const std::size_t before = taken;
    const auto found = call();
    if (taken != before) fail("%s took memory", name);
    return found;
}

bool finite(const double* values, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i)
        if (!std::isfinite(values[i])) return false;
    return true;
}
bool finite(const Numbers& values) { return finite(values.data(), values.size()); }

double norm(const double* values, int count) {
    double square = 0.0;
    for (int i = 0; i < count; ++i) square += values[i] * values[i];
    return std::sqrt(square);
}

// -- numbers from bytes -----------------------------------------------------------------------------------------------

class Bytes {
public:
    Bytes(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {
        for (std::size_t i = 0; i < size; ++i) rest_ = (rest_ ^ data[i]) * 1099511628211u;
    }

    // After the last byte: what follows from all of them.
    std::uint8_t byte() {
        const std::size_t at = at_++;
        return at < size_ ? data_[at] : static_cast<std::uint8_t>(mixed(rest_ + at));
    }

    int below(int count) { return (byte() << 8 | byte()) % count; }
    int between(int least, int most) { return least + below(most - least + 1); }
    bool once_in(int count) { return below(count) == 0; }

    // In [0, 1): the first digits from bytes, the others from where they are.
    double share() {
        const double first = byte() << 8 | byte();
        return (first + static_cast<double>(mixed(at_) >> 11) * 0x1p-53) / 65536.0;
    }
    double from(double least, double most) { return least + (most - least) * share(); }
    double spread(double size) { return from(-size, size); }

    double hostile() {
        constexpr double inf = infinity;
        const double values[] = {0.0,    -0.0,    none,   -none,   inf,      -inf,  1e12,  -1e12, 9.9e11,
                                 1e-300, -1e-300, 5e-324, -5e-324, 2.3e-308, 1e6,   -1e6,  1e-9,  1e300,
                                 -1e300, 1.0,     -1.0,   1e-12,   1e30,     1e155, 1e-155};
        const int which = below(2 * static_cast<int>(std::size(values)));
        return which < static_cast<int>(std::size(values)) ? values[which] : spread(std::pow(10.0, between(-12, 12)));
    }

    // Some of the values become hostile ones.
    void spoil(double* values, int count) {
        if (count == 0) return;
        if (once_in(16)) {
            for (int i = 0; i < count; ++i) values[i] = hostile();
            return;
        }
        for (int left = between(1, 2); left > 0; --left) values[below(count)] = hostile();
    }
    void spoil(Numbers& values) { spoil(values.data(), static_cast<int>(values.size())); }

private:
    const std::uint8_t* data_;
    std::size_t size_, at_ = 0;
    std::uint64_t rest_ = 1469598103934665603u;

    static std::uint64_t mixed(std::uint64_t z) {
        z += 0x9e3779b97f4a7c15u;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        return z ^ (z >> 31);
    }
};

// -- grasps -----------------------------------------------------------------------------------------------------------

enum class Kind { reasonable, degenerate, edge, garbage };
constexpr const char* kinds[] = {"reasonable", "degenerate", "at its limits", "garbage"};

struct Model {
    int d, round;
};
constexpr Model models[] = {{3, 0}, {3, 2}, {4, 0}, {4, 2}, {4, 3}};

struct Grasp {
    Kind kind = Kind::reasonable;
    Model model{};
    int k = 0;
    bool moments = true;
    bool excluded = false;  // there are no forces, by a percent
    double radius = 0.0, arm = 1.0, torsion = 0.0, safety = 1.0;
    Numbers points, rotations, mu, low, high, load = Numbers(6, 0.0);

    double slip(int i) const { return mu[i] / safety; }
    double twist() const { return torsion / safety; }
    int rows() const { return moments ? 6 : 3; }
};

void cross(const double* a, const double* b, double* out) {
    for (int c = 0; c < 3; ++c) out[c] = a[(c + 1) % 3] * b[(c + 2) % 3] - a[(c + 2) % 3] * b[(c + 1) % 3];
}

// A frame with this z axis, turned about it.
void frame(const double* z, double angle, double* R) {
    const int least = std::fabs(z[0]) < 0.6 ? 0 : 1;
    double x[3] = {}, y[3];
    x[least] = 1.0;
    cross(z, x, y);
    const double size = norm(y, 3);
    for (double& one : y) one /= size;
    cross(y, z, x);
    for (int c = 0; c < 3; ++c) {
        R[3 * c] = std::cos(angle) * x[c] + std::sin(angle) * y[c];
        R[3 * c + 1] = std::cos(angle) * y[c] - std::sin(angle) * x[c];
        R[3 * c + 2] = z[c];
    }
}

// Contacts around a circle, at irregular heights and angles.
void place_around(Bytes& bytes, Grasp& grasp, double jitter) {
    const int k = grasp.k;
    for (int i = 0; i < k; ++i) {
        const double angle = 6.283185307179586 * i / k + bytes.spread(jitter), tilt = bytes.spread(jitter);
        double* p = grasp.points.data() + 3 * i;
        p[0] = grasp.radius * std::cos(angle);
        p[1] = grasp.radius * std::sin(angle);
        p[2] = grasp.radius * bytes.spread(2.0 * jitter);
        double z[3] = {-std::cos(angle), -std::sin(angle), tilt};
        const double size = norm(z, 3);
        for (double& one : z) one /= size;
        frame(z, jitter > 0.0 ? bytes.spread(3.2) : 0.0, grasp.rotations.data() + 9 * i);
    }
}

void degrade(Bytes& bytes, Grasp& grasp) {
    const int k = grasp.k;
    for (int left = bytes.between(1, 2); left > 0; --left) {
        const double tiny = bytes.once_in(2) ? 0.0 : 1e-9, size = std::max(norm(grasp.load.data(), 6), 1e-3);
        switch (bytes.below(12)) {
            case 0:  // points that coincide
                for (int i = 1; i < k; ++i) std::copy_n(grasp.points.data(), 3, grasp.points.data() + 3 * i);
                break;
            case 1:
                for (double& one : grasp.mu) one = tiny;
                break;
            case 2:
                grasp.mu[bytes.below(k)] = 0.0;
                break;
            case 3:  // on a line, normals alike
                for (int i = 0; i < k; ++i) {
                    grasp.points[3 * i] = grasp.radius * i;
                    grasp.points[3 * i + 1] = grasp.points[3 * i + 2] = tiny;
                    std::copy_n(grasp.rotations.data(), 9, grasp.rotations.data() + 9 * i);
                }
                break;
            case 4:  // no room between the limits
                for (int i = 0; i < k; ++i)
                    if (bytes.once_in(2)) grasp.high[i] = grasp.low[i] = bytes.share() * size;
                break;
            case 5:
            case 6: {
                const double share = (bytes.once_in(2) ? 1e-9 : 1e6) / size;
                for (double& one : grasp.load) one *= share;
                if (bytes.once_in(2))
                    for (int i = 0; i < k; ++i) {
                        grasp.low[i] *= share;
                        grasp.high[i] *= share;
                    }
                break;
            }
            case 7:
                for (double& one : grasp.load) one = 0.0;
                break;
            case 8:  // two contacts at one place
                std::copy_n(grasp.points.data(), 3, grasp.points.data() + 3 * (k - 1));
                std::copy_n(grasp.rotations.data(), 9, grasp.rotations.data() + 9 * (k - 1));
                break;
            case 9:
                for (double& one : grasp.points) one *= tiny;
                break;
            case 10:
                grasp.high[bytes.below(k)] = 0.0;
                grasp.low[0] = 0.0;
                break;
            default:  // very large or small limits
                for (int i = 0; i < k; ++i) grasp.high[i] = grasp.low[i] + size * std::pow(10.0, bytes.between(-6, 6));
        }
    }
    for (int i = 0; i < k; ++i) {
        grasp.high[i] = std::min(grasp.high[i], 1e11);
        grasp.low[i] = std::min(grasp.low[i], grasp.high[i]);
    }
}

// The load along the axis of a circle that its contacts can just not, or just bear.
void to_the_edge(Bytes& bytes, Grasp& grasp) {
    place_around(bytes, grasp, 0.0);
    const double mu = bytes.from(0.3, 1.0), high = std::pow(10.0, bytes.between(-1, 2)) * bytes.from(1.0, 9.0);
    double most = 0.0;
    for (int i = 0; i < grasp.k; ++i) {
        grasp.mu[i] = mu;
        grasp.low[i] = 0.0;
        grasp.high[i] = high;
        const double* R = grasp.rotations.data() + 9 * i;
        const double u = std::fabs(R[6]), v = std::fabs(R[7]);
        most += grasp.slip(i) * high * (grasp.model.round ? std::sqrt(u * u + v * v) : std::sqrt(0.5) * (u + v));
    }
    grasp.excluded = bytes.once_in(2);
    grasp.load = {0.0, 0.0, -most * (grasp.excluded ? 1.01 : 0.99), 0.0, 0.0, 0.0};
}

Grasp grasp_from(Bytes& bytes, const Model& model, int contacts = 0) {
    Grasp grasp;
    const int chance = bytes.below(20);
    grasp.kind = chance < 10   ? Kind::reasonable
                 : chance < 14 ? Kind::degenerate
                 : chance < 16 ? Kind::edge
                               : Kind::garbage;
    grasp.model = model;
    const int k = grasp.k = contacts ? contacts : bytes.once_in(8) ? bytes.between(1, 20) : bytes.between(2, 8);
    grasp.moments = !bytes.once_in(4);
    grasp.radius = grasp.arm = bytes.from(0.01, 0.1);
    grasp.torsion = model.d == 4 ? grasp.radius * bytes.from(0.05, 0.5) : 0.0;
    grasp.safety = bytes.once_in(3) ? bytes.from(1.0, 2.0) : 1.0;
    grasp.points.resize(3 * k);
    grasp.rotations.resize(9 * k);
    for (Numbers* one : {&grasp.mu, &grasp.low, &grasp.high}) one->resize(k);
    if (grasp.kind == Kind::edge) {
        to_the_edge(bytes, grasp);
        return grasp;
    }
    place_around(bytes, grasp, 0.3);
    const double size = std::pow(10.0, bytes.from(-1.0, 2.0)), room = bytes.from(0.5, 5.0);
    for (int r = 0; r < 6; ++r) grasp.load[r] = bytes.spread(r < 3 ? size : 0.3 * size * grasp.radius);
    for (int i = 0; i < k; ++i) {
        grasp.mu[i] = bytes.from(0.3, 1.0);
        grasp.low[i] = bytes.once_in(2) ? 0.0 : size * bytes.from(0.0, 0.1);
        grasp.high[i] = grasp.low[i] + size * room * bytes.from(0.5, 1.0);
    }
    if (grasp.kind == Kind::degenerate) degrade(bytes, grasp);
    if (grasp.kind == Kind::garbage) {
        if (bytes.once_in(2)) degrade(bytes, grasp);
        Numbers* parts[] = {&grasp.points, &grasp.rotations, &grasp.mu, &grasp.low, &grasp.high, &grasp.load};
        for (int left = bytes.between(0, 2); left > 0; --left) bytes.spoil(*parts[bytes.below(6)]);
    }
    return grasp;
}

// The size of load and limits: what forces are compared with.
double size_of(const Grasp& grasp) {
    double size = 0.0;
    for (int r = 0; r < grasp.rows(); ++r)
        size = std::max(size, std::fabs(r < 3 ? grasp.load[r] : grasp.load[r] / grasp.arm));
    return size;
}

// Friction and limits of F_n, in newtons; `slack` [N].
void check_limits(const Grasp& grasp, const double* forces, const double* moments, const double* low,
                  const double* high, double slack) {
    for (int i = 0; i < grasp.k; ++i) {
        const double *f = forces + 3 * i, F = f[2], slip = grasp.slip(i), twist = grasp.twist();
        const double least = slack + 1e-9 * std::fabs(F), most = F + least;
        if (slip < 0.0) continue;  // says nothing
        const double x = std::fabs(f[0]), y = std::fabs(f[1]), m = grasp.model.d == 4 ? std::fabs(moments[i]) : 0.0;
        if (!(F >= low[i] - least && F <= high[i] + least))
            fail("F_n of contact %d: %.17g out of [%.17g, %.17g]", i, F, low[i], high[i]);
        const double wide = grasp.model.round ? 1.0 : std::sqrt(0.5);
        bool held = x <= wide * slip * most && y <= wide * slip * most && m <= twist * most;
        if (grasp.model.round && slip > 0.0) {
            const double turn = grasp.model.round == 3 && twist > 0.0 ? m / twist : 0.0;
            held = held && std::sqrt(x * x / slip / slip + y * y / slip / slip + turn * turn) <= most;
        }
        if (!held) fail("friction of contact %d: (%.17g, %.17g), %.17g at %.17g, mu %.17g", i, f[0], f[1], m, F, slip);
    }
}

// What forces and load leave over [N], moments over the arm.
double left_over(const Grasp& grasp, const double* forces, const double* moments) {
    double rest[6];
    std::copy_n(grasp.load.data(), 6, rest);
    for (int i = 0; i < grasp.k; ++i) {
        const double *R = grasp.rotations.data() + 9 * i, *f = forces + 3 * i;
        double world[3], about[3];
        for (int c = 0; c < 3; ++c) world[c] = R[3 * c] * f[0] + R[3 * c + 1] * f[1] + R[3 * c + 2] * f[2];
        cross(grasp.points.data() + 3 * i, world, about);
        for (int c = 0; c < 3; ++c) {
            rest[c] += world[c];
            rest[3 + c] += about[c] + (grasp.model.d == 4 ? R[3 * c + 2] * moments[i] : 0.0);
        }
    }
    for (int c = 3; c < 6; ++c) rest[c] /= grasp.arm;
    return norm(rest, grasp.rows());
}

double largest_of(const double* forces, int k) {
    double most = 0.0;
    for (int i = 0; i < 3 * k; ++i) most = std::max(most, std::fabs(forces[i]));
    return most;
}

// -- tick by tick -----------------------------------------------------------------------------------------------------

struct Hand {
    int joints = 0, columns = 0;
    Numbers jacobian, gravity;
};

class Ticks {
public:
    explicit Ticks(Bytes& bytes) : bytes_(bytes), grasp_(grasp_from(bytes, models[bytes.below(5)])) {
        OnlineSetup setup;
        setup.contacts = grasp_.k;
        setup.components = grasp_.model.d;
        setup.round = grasp_.model.round;
        setup.moments = grasp_.moments;
        setup.torsion = grasp_.torsion;
        setup.arm = grasp_.arm;
        setup.safety = grasp_.safety;
        setup.ramp = bytes.once_in(2) ? 1.0 : bytes.from(0.01, 1.0);
        if (bytes.once_in(4)) setup.most_rate = std::max(size_of(grasp_), 1e-3) * bytes.from(0.001, 1.0);
        if (bytes.once_in(4)) setup.most_steps = bytes.between(1, 10);
        if (bytes.once_in(2)) hand_from(setup);
        limits_.assign(setup.joints, infinity);
        garbage_ = grasp_.kind == Kind::garbage;
        if (bytes.once_in(4)) {
            // Either there is no loop, or all is promised that is promised of others.
            OnlineSetup spoilt = setup;
            spoil(spoilt);
            loop_ = make_online(spoilt);
            if ((loop_ == nullptr) != (fault_of(spoilt) != nullptr)) fail("a fault that is none, or one that is not told");
            if (loop_ == nullptr)
                ++refused;
            else {
                setup = spoilt;
                garbage_ = true;  // no longer known to have forces, or none
                grasp_.excluded = false;
            }
        }
        grasp_.model = {setup.components, setup.round};
        grasp_.torsion = setup.torsion;
        grasp_.arm = setup.arm;
        grasp_.safety = setup.safety;
        for (double& one : setup.coupled)
            if (!(std::fabs(one) < 1e12)) one = 0.0;  // of a load that is none
        if (loop_ == nullptr) loop_ = make_online(setup);
        if (loop_ == nullptr) fail("no loop: %s", fault_of(setup));
        setup_ = setup;
        for (double& one : com_) one = bytes.spread(0.1);
        const double size = std::max(size_of(grasp_), 1e-3) * 0.1;
        for (double& one : limits_)
            if (!bytes.once_in(8)) one = bytes.once_in(2) ? size : 0.1 + size * bytes.from(0.0, 0.3);
        fill(*loop_);
    }

    void run() {
        for (int left = bytes_.between(2, 10); left > 0; --left) {
            if (garbage_) spoil();
            tick();
            change();
        }
        again();
    }

private:
    Bytes& bytes_;
    Grasp grasp_;
    OnlineSetup setup_;
    Hand hand_;
    double com_[3] = {};
    Numbers limits_;  // of the torques
    std::unique_ptr<Online> loop_;
    bool garbage_ = false;

    // A number or an index of a set-up becomes a hostile one.
    void spoil(OnlineSetup& setup) {
        double* values[] = {&setup.torsion, &setup.arm, &setup.safety, &setup.ramp, &setup.most_rate, &setup.borne};
        std::vector<int*> indices{&setup.components, &setup.round, &setup.most_steps, &setup.couplings};
        for (int& joint : setup.limited) indices.push_back(&joint);
        for (Link& link : setup.links) indices.insert(indices.end(), {&link.contact, &link.joint});
        constexpr int strange[] = {-1, 0, 1, 2, 3, 4, 7, 1000000, std::numeric_limits<int>::max(), std::numeric_limits<int>::min()};
        switch (bytes_.below(4)) {
            case 0:
                *values[bytes_.below(6)] = bytes_.hostile();
                break;
            case 1:
                *indices[bytes_.below(static_cast<int>(indices.size()))] = strange[bytes_.below(10)];
                break;
            case 2:
                if (!setup.coupled.empty()) bytes_.spoil(bytes_.once_in(2) ? setup.coupled : setup.coupling_rows);
                if (bytes_.once_in(4)) setup.coupling_rows.push_back(0.0);
                break;
            default:
                setup.limited.push_back(strange[bytes_.below(10)]);
        }
    }

    void hand_from(OnlineSetup& setup) {
        const int n = hand_.joints = setup.joints = bytes_.between(0, 8);
        hand_.columns = n + 2;  // two of them for joints that follow
        for (int i = 0; n > 0 && i < grasp_.k; ++i)
            for (int left = bytes_.below(4); left > 0; --left)
                setup.links.push_back({i, bytes_.below(hand_.columns), bytes_.below(n)});
        for (int j = 0; j < n; ++j)
            if (bytes_.once_in(2)) setup.limited.push_back(j);
        setup.couplings = n > 0 && bytes_.once_in(3) ? bytes_.between(1, 2) : 0;
        for (int c = 0; c < setup.couplings; ++c) {
            for (int j = 0; j < n; ++j) setup.coupling_rows.push_back(bytes_.once_in(3) ? 0.0 : bytes_.spread(1.0));
            setup.coupled.push_back(bytes_.once_in(2) ? 0.0 : bytes_.spread(0.01 * size_of(grasp_) * grasp_.radius));
        }
        setup.borne = bytes_.once_in(2) ? 0.0 : bytes_.from(0.0, 0.5);
        for (int c = 0; c < hand_.columns; ++c)
            for (int r = 0; r < 6; ++r) hand_.jacobian.push_back(bytes_.spread(r < 3 ? 0.05 : 1.0));
        for (int j = 0; j < n; ++j) hand_.gravity.push_back(bytes_.spread(0.01));
    }

    void fill(Online& loop) {
        std::copy(grasp_.load.begin(), grasp_.load.end(), loop.wrench);
        std::copy(grasp_.points.begin(), grasp_.points.end(), loop.points);
        std::copy(grasp_.rotations.begin(), grasp_.rotations.end(), loop.rotations);
        std::copy(grasp_.mu.begin(), grasp_.mu.end(), loop.mu);
        std::copy(grasp_.low.begin(), grasp_.low.end(), loop.least);
        std::copy(grasp_.high.begin(), grasp_.high.end(), loop.largest);
        std::copy(limits_.begin(), limits_.end(), loop.torque_limit);
        std::copy_n(com_, 3, loop.com);
        std::fill_n(loop.share, grasp_.k, 1.0);
        std::fill_n(loop.target, grasp_.k, 1.0);
        loop.jacobian = hand_.jacobian.data();
        loop.gravity = hand_.gravity.data();
    }

    // Whatever was, a loop that is reset is as good as a new one.
    void again() {
        const auto other = make_online(setup_);
        for (Online* one : {loop_.get(), other.get()}) {
            fill(*one);
            one->moved = true;
        }
        loop_->reset();
        const Tick found = loop_->tick(), expected = other->tick();
        if (found != expected) fail("reset: %d, new: %d", int(found), int(expected));
        if (found != Tick::converged) return;
        const double most = largest_of(other->forces, grasp_.k);
        for (int i = 0; i < 3 * grasp_.k; ++i)
            if (!(std::fabs(loop_->forces[i] - other->forces[i]) <= 1e-6 * most))
                fail("reset: %.17g, new: %.17g", loop_->forces[i], other->forces[i]);
    }

    // Hostile numbers among the inputs of a tick.
    void spoil() {
        if (!bytes_.once_in(3)) return;
        const int k = grasp_.k, n = hand_.joints;
        switch (bytes_.below(10)) {
            case 0:
                return bytes_.spoil(loop_->wrench, 6);
            case 1:
                return bytes_.spoil(loop_->com, 3);
            case 2:
                return bytes_.spoil(loop_->least, k);
            case 3:
                return bytes_.spoil(loop_->largest, k);
            case 4:
                return bytes_.spoil(loop_->torque_limit, n);
            case 5:
                return bytes_.spoil(hand_.jacobian);
            case 6:
                return bytes_.spoil(hand_.gravity);
            case 7:
                return bytes_.spoil(bytes_.once_in(2) ? loop_->share : loop_->target, k);
            case 8:
                bytes_.spoil(loop_->mu, k);
                break;
            default:
                bytes_.spoil(bytes_.once_in(2) ? loop_->points : loop_->rotations, 3 * k);
        }
        loop_->moved = true;
    }

    // Another load, other places, a contact less or more, a new start.
    void change() {
        const int k = grasp_.k;
        grasp_.excluded = false;
        switch (bytes_.below(8)) {
            case 0:
                for (double& one : loop_->wrench) one *= bytes_.from(0.9, 1.1);
                break;
            case 1:
                std::copy(grasp_.load.begin(), grasp_.load.end(), loop_->wrench);
                for (double& one : loop_->wrench) one *= bytes_.spread(2.0);
                break;
            case 2:
                for (int i = 0; i < 3 * k; ++i)
                    loop_->points[i] = grasp_.points[i] + bytes_.spread(0.05) * grasp_.radius;
                loop_->moved = true;
                break;
            case 3:
                for (int i = 0; i < k; ++i) loop_->mu[i] = grasp_.mu[i] * bytes_.from(0.8, 1.2);
                loop_->moved = true;
                break;
            case 4:
                loop_->engage(bytes_.below(k), bytes_.once_in(2), bytes_.once_in(4));
                break;
            case 5:
                if (bytes_.once_in(4)) loop_->reset();
                break;
            case 6:
                for (double& one : hand_.jacobian) one += bytes_.spread(0.01);
                break;
            default:
                break;
        }
    }

    void tick() {
        const int k = grasp_.k, n = hand_.joints;
        // As it was, for ticks that change nothing, and for the limits of this one.
        const auto copy = [](const double* from, int count) { return Numbers(from, from + count); };
        const auto state = [&] {
            Numbers all;
            for (const Numbers& part : {copy(loop_->forces, 3 * k), copy(loop_->moments, k), copy(loop_->unbalanced, 6),
                                        copy(loop_->torques, n), copy(loop_->multipliers, 6), copy(loop_->share, k)})
                all.insert(all.end(), part.begin(), part.end());
            return all;
        };
        const Numbers before = state();
        const bool started = loop_->started;
        const Tick found = without_memory("Online::tick", [&] { return loop_->tick(); });
        ++ticks.at[found == Tick::unusable ? 3 : static_cast<int>(found)];
        if (found == Tick::unusable) {
            if (!garbage_) fail("unusable");
            const Numbers after = state();
            if (std::memcmp(before.data(), after.data(), 8 * before.size())) fail("an unusable tick changed something");
            return;
        }
        if (garbage_ && found != Tick::converged) return;
        // What was solved.
        Grasp now = grasp_;
        std::copy_n(loop_->wrench, 6, now.load.data());
        std::copy_n(loop_->points, 3 * k, now.points.data());
        std::copy_n(loop_->rotations, 9 * k, now.rotations.data());
        std::copy_n(loop_->mu, k, now.mu.data());
        const Numbers after = state();
        if (!finite(after) || !std::isfinite(loop_->off)) fail("tick %d: not all outputs are finite", int(found));
        double size = std::max(size_of(now), 1e-9);
        const double rate = started ? setup_.most_rate : infinity;
        for (int i = 0; i < k; ++i) {
            const double low = loop_->least[i] * loop_->share[i], high = loop_->largest[i] * loop_->share[i];
            const double F = before[3 * i + 2];
            now.low[i] = std::min(std::max(low, F - rate), high);
            now.high[i] = std::max(std::min(high, F + rate), now.low[i]);
            const bool leaves = loop_->target[i] < 1.0;  // from what it was, as fast as the rate allows
            if (leaves) {
                now.high[i] = std::min(loop_->largest[i], std::max(now.high[i], F - rate));
                now.low[i] = std::min(std::max(low, F - rate), now.high[i]);
            }
            size = std::max(size, now.low[i]);
            if (leaves) now.low[i] = 0.0;
        }
        check_limits(now, loop_->forces, loop_->moments, now.low.data(), now.high.data(), 1e-9 * size);
        if (found != Tick::converged) return;
        if (now.excluded) fail("a load beyond the limits is held");
        if (!(loop_->off <= 1e-9 * std::max(1.0, size))) fail("off by %g at %g", loop_->off, size);
        if (!garbage_) {
            const double most = largest_of(loop_->forces, k) + size,
                         rest = left_over(now, loop_->forces, loop_->moments);
            if (!(rest <= 1e-9 * most)) fail("%g N are left over, off %g, of %g N", rest, loop_->off, most);
        }
        for (int j : setup_.limited)
            if (!(std::fabs(loop_->torques[j]) <= loop_->torque_limit[j] * (1.0 + 1e-6)))
                fail("torque of joint %d: %.17g beyond %.17g", j, loop_->torques[j], loop_->torque_limit[j]);
    }
};

// -- one problem ------------------------------------------------------------------------------------------------------

// Pseudoinverse (n, m) of A (m, n), by Jacobi's eigenvectors of A A'.
Numbers pseudoinverse(const double* A, int m, int n) {
    double S[6][6], V[6][6] = {};
    for (int r = 0; r < m; ++r)
        for (int c = 0; c < m; ++c) {
            S[r][c] = 0.0;
            V[r][c] = r == c;
            for (int l = 0; l < n; ++l) S[r][c] += A[r * n + l] * A[c * n + l];
        }
    for (int sweep = 0; sweep < 12; ++sweep)
        for (int p = 0; p < m; ++p)
            for (int q = p + 1; q < m; ++q) {
                if (S[p][q] == 0.0) continue;
                const double angle = 0.5 * std::atan2(2.0 * S[p][q], S[q][q] - S[p][p]), c = std::cos(angle),
                             s = std::sin(angle);
                for (int i = 0; i < m; ++i) {
                    const double a = S[i][p], b = S[i][q];
                    S[i][p] = c * a - s * b;
                    S[i][q] = s * a + c * b;
                }
                for (int i = 0; i < m; ++i) {
                    const double a = S[p][i], b = S[q][i];
                    S[p][i] = c * a - s * b;
                    S[q][i] = s * a + c * b;
                }
                for (int i = 0; i < m; ++i) {
                    const double a = V[i][p], b = V[i][q];
                    V[i][p] = c * a - s * b;
                    V[i][q] = s * a + c * b;
                }
            }
    double most = 0.0;
    for (int r = 0; r < m; ++r) most = std::max(most, S[r][r]);
    Numbers found(n * m, 0.0);
    for (int e = 0; e < m; ++e) {
        if (!(S[e][e] > 1e-13 * most)) continue;
        for (int l = 0; l < n; ++l) {
            double along = 0.0;
            for (int r = 0; r < m; ++r) along += A[r * n + l] * V[r][e];
            for (int r = 0; r < m; ++r) found[l * m + r] += along * V[r][e] / S[e][e];
        }
    }
    return found;
}

// A problem and all its arrays, each exactly as long as it must be.
struct Case {
    Grasp grasp;
    int r = 0, edges = 0;
    bool own_facets = false;  // facets that say something else than the vertices: nothing is promised
    bool separates = true;
    double peak = 0.0;
    Numbers B, P, q, R_lo, R_hi, correction, widths, matrix, normals, C, vertices, terms;
    std::unique_ptr<Forces> forces;
    double unit = 1.0;

    Case(Bytes& bytes, bool compare) : grasp(grasp_from(bytes, models[bytes.below(5)])) {
        const int k = grasp.k, d = grasp.model.d, n = d * k, m = grasp.rows(), e = d - 1;
        const bool garbage = grasp.kind == Kind::garbage;
        edges = grasp.model.round ? 0 : bytes.once_in(2) ? 4 : 2 * bytes.between(2, bytes.once_in(4) ? 16 : 4);
        for (int a = 0; a < edges; ++a) {
            const double half = 3.141592653589793 / edges, angle = 0.78539816339744828 + 2.0 * half * a;
            const double facet[3] = {std::cos(angle + half) / std::cos(half), std::sin(angle + half) / std::cos(half),
                                     0.0};
            for (int j = 0; j < e; ++j) C.push_back(std::fabs(facet[j]) < 1e-15 ? 0.0 : facet[j]);
            vertices.push_back(std::cos(angle));
            vertices.push_back(std::sin(angle));
        }
        if (d == 4 && grasp.model.round != 3)
            for (double side : {1.0, -1.0}) C.insert(C.end(), {0.0, 0.0, side});
        grasp.excluded = grasp.excluded && edges <= 4;  // by as many edges
        if (garbage && bytes.once_in(4)) {
            own_facets = true;
            C.assign(bytes.between(0, 10) * e, 0.0);
            for (double& one : C) one = bytes.spread(1.5);
            if (bytes.once_in(2)) bytes.spoil(C);
        }
        r = bytes.once_in(2) ? 0 : bytes.between(0, 6);
        widths.resize(n);
        matrix.resize(18 * k);
        normals.resize(3 * k);
        B.assign((m + r) * n, 0.0);
        for (int i = 0; i < k; ++i) {
            const double *R = grasp.rotations.data() + 9 * i, *p = grasp.points.data() + 3 * i;
            for (int j = 0; j < d; ++j) {
                const int c = j == e ? 2 : j;
                const double size = widths[j * k + i] = j == e ? 1.0 : j == 2 ? grasp.twist() : grasp.slip(i);
                double column[6] = {R[c], R[3 + c], R[6 + c], 0.0, 0.0, 0.0};
                if (j == 2 && e == 3) {
                    for (int a = 0; a < 3; ++a) {
                        column[a] = 0.0;
                        column[3 + a] = R[3 * a + 2];
                    }
                } else {
                    cross(p, column, column + 3);
                    for (int row = 0; row < 6; ++row) matrix[(row * k + i) * 3 + c] = column[row];
                }
                for (int row = 0; row < m; ++row)
                    B[row * n + j * k + i] = size * (row < 3 ? column[row] : column[row] / grasp.arm);
            }
            for (int a = 0; a < 3; ++a) normals[3 * i + a] = R[3 * a + 2];
        }
        const double size = std::max(std::isfinite(size_of(grasp)) ? size_of(grasp) : 1.0, 1e-9);
        for (int h = 0; h < r; ++h) {
            double square = 0.0, *row = B.data() + (m + h) * n;
            for (int l = 0; l < n; ++l) {
                row[l] = bytes.once_in(3) || widths[l] == 0.0 ? 0.0 : bytes.spread(1.0);
                square += row[l] * row[l];
            }
            for (int l = 0; l < n && square > 0.0; ++l) row[l] /= std::sqrt(square);
            R_lo.push_back(size * (bytes.once_in(8) ? bytes.spread(0.5) : bytes.from(-2.0, -0.1)));
            R_hi.push_back(R_lo.back() + size * (bytes.once_in(8) ? 1e-6 : bytes.from(0.5, 3.0)));
        }
        correction = pseudoinverse(B.data(), m, n);
        cost(bytes, compare);
        const GraspSetup fair = setup();
        if (garbage && bytes.once_in(2)) {
            Numbers* parts[] = {&B, &P, &q, &R_lo, &R_hi, &correction, &widths, &terms};
            bytes.spoil(*parts[bytes.below(8)]);
        }
        const GraspSetup spoilt = setup();
        forces = make_forces(spoilt);
        if ((forces == nullptr) != (fault_of(spoilt) != nullptr)) fail("a fault that is none, or one that is not told");
        if (forces == nullptr) {
            ++refused;
            forces = make_forces(fair);
        }
        // Of numbers that are none there is no grasp to be solved.
        if (forces == nullptr && !garbage) fail("no grasp: %s", fault_of(fair));
    }

    // The objective: squares of the forces, or of combinations of a contact's own, powers of F_n, and the largest F_n.
    void cost(Bytes& bytes, bool compare) {
        const int k = grasp.k, d = grasp.model.d, n = d * k;
        P.assign(d * n, 0.0);
        q.assign(n, 0.0);
        const int kind = compare ? bytes.below(2) : bytes.below(4);
        for (int i = 0; i < k; ++i)
            for (int j = 0; j < d; ++j) {
                // Components of a cone alike.
                const double width = widths[(j < grasp.model.round ? 0 : j) * k + i];
                double& own = P[(j * d + j) * k + i];
                if (kind == 0) own = 2.0 * (j == d - 1 ? 1.0 : std::max(width * width, 1e-4));
                const int joint = edges > 4 ? 2 : grasp.model.round;
                if (kind == 1) own = j > 0 && j < joint ? P[i] : bytes.from(0.1, 2.0);
            }
        if (kind == 2) {  // products of components
            separates = false;
            for (int i = 0; i < k; ++i) {
                double half[4];
                for (int c = 0; c < 2; ++c) {
                    for (int j = 0; j < d; ++j) half[j] = bytes.spread(1.0);
                    for (int j = 0; j < d; ++j)
                        for (int l = 0; l < d; ++l) P[(j * d + l) * k + i] += half[j] * half[l];
                }
            }
        }
        if (!compare && bytes.once_in(4)) {
            peak = bytes.from(0.01, 1.0);
            separates = false;
        }
        if (bytes.once_in(3))
            for (double& one : q) one = bytes.from(0.0, 0.3) * std::max(size_of(grasp), 1e-9);
        const int powers = compare ? 0 : kind == 3 ? bytes.between(1, 8) : bytes.once_in(2) ? 0 : bytes.between(1, 8);
        for (int a = 0; a < powers; ++a) {
            const double exponents[] = {1.0, 5.0 / 3.0, 2.0, 1.5, 5.0, 1.2, 3.0, 10.0 / 3.0};
            terms.push_back(bytes.from(0.01, 1.0));
            terms.push_back(bytes.once_in(4) ? bytes.from(1.0, 6.0) : exponents[bytes.below(8)]);
        }
    }

    GraspSetup setup() const {
        GraspSetup setup;
        setup.k = grasp.k;
        setup.m = grasp.rows();
        setup.r = r;
        setup.d = grasp.model.d;
        setup.round = grasp.model.round;
        setup.separates = separates;
        setup.facets = C;
        setup.vertices = vertices;
        setup.B = B;
        setup.P = P;
        setup.q = q;
        setup.R_lo = R_lo;
        setup.R_hi = R_hi;
        setup.correction = correction;
        setup.widths = widths;
        setup.grasp_matrix = matrix;
        setup.normals = normals;
        for (double one : P) setup.largest = std::max(setup.largest, one);
        setup.peak = peak;
        setup.arm = grasp.arm;
        return setup;
    }

    // Of newtons (k, 3) and newton metres (k) the largest miss of the torque rows; with `square` the sum of squares.
    double missed_torques(const double* forces, const double* moments, bool square) const {
        const int k = grasp.k, d = grasp.model.d, m = grasp.rows(), n = d * k;
        double worst = 0.0, total = 0.0;
        for (int h = 0; h < r; ++h) {
            double t = 0.0;
            for (int l = 0; l < n; ++l) {
                const int j = l / k, i = l % k;
                const double own = j == 2 && d == 4 ? moments[i] : forces[3 * i + (j == d - 1 ? 2 : j)];
                if (widths[l] > 0.0) t += B[(m + h) * n + l] * own / widths[l];
            }
            const double off = std::max({t - R_hi[h], R_lo[h] - t, 0.0});
            worst = std::max(worst, off);
            total += off * off;
        }
        return square ? total : worst;
    }
};

// The proof that no forces hold the load, and the closest ones, in newtons.
void prove_case(Case& own, const Record& record) {
    const Grasp& grasp = own.grasp;
    const int k = grasp.k;
    Numbers direction(grasp.rows() + own.r, 0.0);
    const double margin = without_memory("Forces::prove", [&] {
        return own.forces->prove(grasp.low.data(), grasp.high.data(), grasp.load.data(), record, direction.data());
    });
    if (!(margin > 0.0) || own.own_facets || grasp.kind == Kind::garbage || grasp.kind == Kind::degenerate) return;
    ++proven_loads;
    const double length = norm(direction.data(), static_cast<int>(direction.size()));
    if (!(std::fabs(length - 1.0) < 1e-9)) fail("a proof along a direction of length %g", length);
    double most = size_of(grasp);
    for (int i = 0; i < k; ++i) most = std::max(most, record.forces[3 * i + 2]);
    // No admissible forces leave less, and these are the closest: they leave no more, either.
    const double square = own.missed_torques(record.forces, record.torsion, true);
    const double rest = std::hypot(left_over(grasp, record.forces, record.torsion), std::sqrt(square)),
                 rounding = 1e-7 * most;
    if (!(rest >= margin - rounding)) fail("%.9g N are left over where %.9g are proven", rest, margin);
    if (!(rest <= margin + rounding)) fail("the closest forces leave %.9g N, %.9g are proven", rest, margin);
    if (own.edges <= 4)
        check_limits(grasp, record.forces, record.torsion, grasp.low.data(), grasp.high.data(), 1e-8 * most);
}

// In newtons, from load to record.
void solve_case(Bytes& bytes, Case& own) {
    const Grasp& grasp = own.grasp;
    const int k = grasp.k;
    Numbers wrench(6, none), forces(3 * k, none), torsion(k, none);
    std::unique_ptr<bool[]> flags[3], torque(new bool[own.r]());
    for (auto& one : flags) one.reset(new bool[k]());
    const Record record{wrench.data(),  forces.data(),  torsion.data(), flags[0].get(),
                        flags[1].get(), flags[2].get(), torque.get()};
    const bool newton = bytes.once_in(2);
    const Outcome found = without_memory("Forces::solve", [&] {
        return own.forces->solve(newton, grasp.low.data(), grasp.high.data(), own.terms.data(),
                                 static_cast<int>(own.terms.size()) / 2, grasp.load.data(), record);
    });
    ++solved.at[static_cast<int>(found.checked.code)];
    Tolerance tolerance;
    tolerance.residual = 1e-9;
    tolerance.violation = 1e-8;
    tolerance.negligible = 1e-5;
    const Certificate sure(found, tolerance);
    if (!sure.optimal) {
        prove_case(own, record);
        return;
    }
    ++certified;
    for (double one : {sure.objective, sure.lower_bound, sure.residual_norm, sure.violation, sure.load_size,
                       sure.force_size, sure.objective_size})
        if (!std::isfinite(one)) fail("a certificate of numbers that are none");
    if (own.own_facets || grasp.kind == Kind::garbage) return;
    if (!finite(wrench) || !finite(forces) || !finite(torsion)) fail("certified forces that are not finite");
    if (sure.lower_bound > sure.objective) fail("bound %g above objective %g", sure.lower_bound, sure.objective);
    if (grasp.excluded) fail("a load beyond the limits is held");
    const double rest = left_over(grasp, forces.data(), torsion.data());
    if (!(rest <= 2e-9 * (sure.load_size + largest_of(forces.data(), k))))
        fail("%g N are left over of %g", rest, sure.load_size);
    const double missed = own.missed_torques(forces.data(), torsion.data(), false);
    if (!(missed <= 2e-8 * sure.force_size)) fail("a torque row is missed by %g of %g", missed, sure.force_size);
    if (own.edges <= 4)
        check_limits(grasp, forces.data(), torsion.data(), grasp.low.data(), grasp.high.data(), 1e-8 * sure.force_size);
}

// Dimensionless: by both methods, whose answers are compared.
void answer_case(Case& own, bool compare) {
    const Grasp& grasp = own.grasp;
    const int k = grasp.k, d = grasp.model.d, n = d * k, m = grasp.rows(), r = own.r;
    const bool promised = !own.own_facets && grasp.kind != Kind::garbage;
    double size = size_of(grasp);
    if (!(size > 0.0 && std::isfinite(size))) size = 1.0;
    Numbers b(m), lo(grasp.low), hi(grasp.high), R_lo(own.R_lo), R_hi(own.R_hi), P(own.P), q(own.q);
    for (int row = 0; row < m; ++row) b[row] = -grasp.load[row] / (row < 3 ? 1.0 : grasp.arm) / size;
    for (Numbers* part : {&lo, &hi, &R_lo, &R_hi, &q})
        for (double& one : *part) one /= size;
    Powers powers;
    if (!powers_of(own.terms.data(), static_cast<int>(own.terms.size()) / 2, 1.0, 1.0, powers)) return;
    if (promised)
        for (int i = 0; i < k; ++i)
            if (!(hi[i] - lo[i] > 1e-9 * hi[i])) return;
    Problem problem =
        own.forces->problem(b.data(), lo.data(), hi.data(), R_lo.data(), R_hi.data(), P.data(), q.data());
    problem.powers = powers;
    problem.peak = own.peak;
    const auto answered = [&](bool newton, const double* load) {
        Problem loaded = problem;
        loaded.b = load;
        return without_memory("Forces::answer", [&] { return own.forces->answer(newton, loaded); });
    };
    Checked found[2];
    double margin[2] = {}, most[2] = {}, reach[2] = {};
    for (int method = 0; method < 2; ++method) {
        const Checked one = found[method] = answered(method == 0, b.data());
        ++answers.at[static_cast<int>(one.code)];
        const double *x = own.forces->x(), *y = own.forces->y();
        if (one.code != Code::converged) {
            margin[method] = excluded(problem, y);
            if (one.code == Code::infeasible && promised && !(margin[method] > 0.0))
                fail("proof of method %d: %g", method, margin[method]);
            double length = 1e-300;
            for (int row = 0; row < m + r; ++row) length = std::max(length, std::fabs(y[row]));
            margin[method] /= length;
            proofs += margin[method] > 1e-9;
        }
        if (one.code != Code::converged || !promised) continue;
        if (!finite(x, n) || !finite(y, m + r) || !std::isfinite(one.value) || !std::isfinite(one.violation))
            fail("method %d: not all of a converged answer is finite", method);
        most[method] = 1.0;
        for (int i = 0; i < k; ++i) most[method] = std::max(most[method], x[(d - 1) * k + i]);
        for (int row = 0; row < m + r; ++row) reach[method] += std::fabs(y[row]);
        const double rest = norm(own.forces->residual(), m);
        if (grasp.excluded && rest <= 1e-9) fail("method %d: a load beyond the limits is held", method);
        const double about = std::max({std::fabs(one.value), 1e-3, most[method] * 1e-3});
        if (one.bound > one.value + 1e-6 * about + 1e-8 * reach[method] * most[method])
            fail("method %d: bound %.17g above its own value %.17g", method, one.bound, one.value);
        // Each alone is a full check: nothing is compared with what missed the balance.
        if (!(rest <= 1e-9 * most[method])) found[method].code = Code::stalled;
    }
    if (!promised) return;
    // Whatever was solved before makes no difference.
    const Checked first = answered(true, b.data());
    const Numbers nowhere(m, none);
    answered(true, nowhere.data());
    const Checked again = answered(true, b.data());
    if (again.code != first.code || again.newton != first.newton)
        fail("after numbers that are none: code %d for %d, newton %d for %d", int(again.code), int(first.code),
             again.newton, first.newton);
    if (!compare || grasp.kind == Kind::degenerate) return;
    const bool newton = found[0].code == Code::converged, interior = found[1].code == Code::converged;
    for (int method = 0; method < 2; ++method)
        if (found[method].code == Code::converged && margin[1 - method] > 0.0) {
            // A proof, whatever it is called.
            if (margin[1 - method] < 1e-7 * most[method])
                ++borderline;
            else
                fail("method %d found forces, the other a proof that there are none (%g)", method, margin[1 - method]);
        }
    if (!newton || !interior) return;
    ++compared;
    const double about = std::max({std::fabs(found[0].value), std::fabs(found[1].value), 1e-3});
    for (int method = 0; method < 2; ++method)
        if (found[method].bound > found[1 - method].value + 1e-6 * about)
            fail("bound of method %d: %.17g above the other's value %.17g", method, found[method].bound,
                 found[1 - method].value);
    // What its caller accepts: the gap is closed.
    for (const Checked& one : found)
        if (!(one.value - one.bound <= 1e-6 * about)) return;
    if (!(std::fabs(found[0].value - found[1].value) <= 1e-6 * about))
        fail("the methods do not agree: %.17g, %.17g", found[0].value, found[1].value);
}

// -- many problems ----------------------------------------------------------------------------------------------------

// The least friction of the same problems, which agrees with what friction of their own was found to be.
void search_friction(Batch batch, const Model& model, const std::vector<Grasp>& grasps,
                     const std::vector<std::int64_t>& before) {
    const auto n = static_cast<std::int64_t>(grasps.size());
    Numbers least(n, infinity);
    std::vector<std::int64_t> codes(n, 99);
    batch.t = 0;
    batch.most_mu = 2.0;
    batch.within = 0.01;
    BatchResults results;
    results.codes = codes.data();
    results.least_mu = least.data();
    solve_batch(batch, model.d, model.round, 0, n, results);
    for (std::int64_t p = 0; p < n; ++p) {
        place = "least friction, problem " + std::to_string(p) + ", " + kinds[int(grasps[p].kind)];
        if (codes[p] < 0 || codes[p] > 2) fail("code %d", int(codes[p]));
        ++searched.at[codes[p]];
        if (codes[p] == 0 && !(least[p] > 0.0)) fail("%g", least[p]);
        if (codes[p] != 0 || grasps[p].kind != Kind::reasonable) continue;
        const auto [low, high] = std::minmax_element(grasps[p].mu.begin(), grasps[p].mu.end());
        if (before[p] == 0 && least[p] > *high + batch.within) fail("%g, but %g is enough", least[p], *high);
        if (before[p] == 2 && least[p] < *low - 1e-6) fail("%g, but %g is too little", least[p], *low);
    }
}

void run_batch(Bytes& bytes) {
    const int n = bytes.between(1, 20), k = bytes.once_in(8) ? bytes.between(1, 20) : bytes.between(2, 6);
    const Model model = models[bytes.below(5)];
    const int t = bytes.once_in(2) ? 0 : bytes.between(1, 8);
    Batch batch;
    batch.k = k;
    batch.t = t;
    batch.moments = !bytes.once_in(4);
    batch.squares = bytes.once_in(8) ? 0.0 : bytes.from(0.1, 2.0);
    if (model.round == 3 && t > 0) batch.squares = 0.0;  // squares of force and moment are no multiple of each other
    batch.torsion = model.d == 4 ? bytes.from(0.001, 0.02) : 0.0;
    std::vector<Grasp> grasps;
    std::vector<std::int64_t> counts(n);
    // What is after a problem's last contact does not count.
    Numbers points(3 * n * k, none), rotations(9 * n * k, none), loads(6 * n), mu(n * k, none), low(n * k, none),
        high(n * k, none), arms(n), terms(2 * n * t);
    for (int p = 0; p < n; ++p) {
        counts[p] = bytes.once_in(4) ? bytes.between(1, k) : k;
        Grasp grasp = grasp_from(bytes, model, static_cast<int>(counts[p]));
        grasp.safety = 1.0;
        if (grasp.kind == Kind::edge) to_the_edge(bytes, grasp);
        grasp.torsion = batch.torsion;
        grasp.moments = batch.moments;
        std::copy(grasp.points.begin(), grasp.points.end(), points.begin() + 3 * k * p);
        std::copy(grasp.rotations.begin(), grasp.rotations.end(), rotations.begin() + 9 * k * p);
        std::copy(grasp.mu.begin(), grasp.mu.end(), mu.begin() + k * p);
        std::copy(grasp.low.begin(), grasp.low.end(), low.begin() + k * p);
        std::copy(grasp.high.begin(), grasp.high.end(), high.begin() + k * p);
        std::copy(grasp.load.begin(), grasp.load.end(), loads.begin() + 6 * p);
        arms[p] = grasp.arm;
        for (int a = 0; a < t; ++a) {
            terms[2 * (p * t + a)] = bytes.once_in(8) ? 0.0 : bytes.from(0.01, 1.0);
            terms[2 * (p * t + a) + 1] = bytes.once_in(2) ? 5.0 / 3.0 : bytes.from(1.0, 5.0);
        }
        if (grasp.kind == Kind::garbage && bytes.once_in(4)) {
            arms[p] = grasp.arm = bytes.hostile();
            if (t > 0) bytes.spoil(terms.data() + 2 * p * t, 2 * t);
        }
        grasps.push_back(std::move(grasp));
    }
    batch.points = points.data();
    batch.rotations = rotations.data();
    batch.counts = counts.data();
    batch.loads = loads.data();
    batch.mu = mu.data();
    batch.low = low.data();
    batch.high = high.data();
    batch.arms = arms.data();
    batch.terms = terms.data();
    Numbers forces(3 * n * k), moments(n * k), objective(n), bound(n), residual(n), violation(n);
    std::vector<std::int64_t> codes(n, 99);
    BatchResults results{forces.data(),   moments.data(),   objective.data(), bound.data(),
                         residual.data(), violation.data(), codes.data()};
    solve_batch(batch, model.d, model.round, 0, n, results);
    for (int p = 0; p < n; ++p) {
        place = "batch, problem " + std::to_string(p) + ", " + kinds[int(grasps[p].kind)];
        const Grasp& grasp = grasps[p];
        if (codes[p] < 0 || codes[p] > 2) fail("code %d", int(codes[p]));
        ++batched.at[codes[p]];
        const double *f = forces.data() + 3 * k * p, *m = moments.data() + k * p;
        for (int i = static_cast<int>(counts[p]); i < k; ++i)
            if (norm(f + 3 * i, 3) != 0.0 || m[i] != 0.0) fail("forces of contacts that do not count");
        if (codes[p] != 0) continue;
        if (!finite(f, 3 * k) || !finite(m, k) || !std::isfinite(objective[p]) || !std::isfinite(bound[p]) ||
            !std::isfinite(residual[p]) || !std::isfinite(violation[p]))
            fail("not all of a converged answer is finite");
        double size = 0.0;
        for (int r = 0; r < grasp.rows(); ++r) size += std::pow(grasp.load[r] / (r < 3 ? 1.0 : grasp.arm), 2.0);
        size = std::sqrt(size);
        if (size == 0.0) size = std::max(grasp.low[0], 1.0);
        if (bound[p] > objective[p] + 1e-12 * std::fabs(objective[p]))
            fail("bound %g above objective %g", bound[p], objective[p]);
        if (!(residual[p] <= 1e-9 * size && violation[p] <= 1e-9 * size))
            fail("residual %g, violation %g of %g", residual[p], violation[p], size);
        if (grasp.excluded) fail("a load beyond the limits is held");
        check_limits(grasp, f, m, grasp.low.data(), grasp.high.data(), 1e-9 * size);
        if (grasp.kind == Kind::garbage) continue;
        const double rest = left_over(grasp, f, m);
        if (!(rest <= 1e-9 * (size + largest_of(f, grasp.k)))) fail("%g N are left over of %g", rest, size);
    }
    // A problem alone: its neighbours make no difference.
    const int p = bytes.below(n);
    place = "batch, problem " + std::to_string(p) + " alone, " + kinds[int(grasps[p].kind)];
    const std::int64_t together = codes[p];
    const double value = objective[p];
    solve_batch(batch, model.d, model.round, p, p + 1, results);
    if (grasps[p].kind != Kind::reasonable) return;
    if (codes[p] != together) fail("code alone %d, with neighbours %d", int(codes[p]), int(together));
    if (together == 0 && !(std::fabs(objective[p] - value) <= 1e-6 * std::fabs(value)))
        fail("alone %.17g, with neighbours %.17g", objective[p], value);
    if (together == 2 || together == 0) codes[p] = together;
    search_friction(batch, model, grasps, codes);
}

// -- contacts as springs ----------------------------------------------------------------------------------------------

void run_springs(Bytes& bytes) {
    const int n = bytes.between(1, 20), k = bytes.between(1, 8), m = width * bytes.between(0, 3);
    const Model model = models[bytes.below(5)];
    const int d = model.d, joints = bytes.between(0, 5);
    const double torsion = d == 4 ? bytes.from(0.001, 0.02) : 0.0;
    std::vector<Grasp> grasps;
    std::vector<std::int64_t> counts(n), rows(n);
    Numbers points(3 * n * k, none), rotations(9 * n * k, none), arms(n), wrenches(6 * m), local(n * k * d),
        capacities(n * k), shares(n, 1.0), jacobians(n * k * 6 * joints), bias(n * joints);
    for (int p = 0; p < n; ++p) {
        counts[p] = bytes.once_in(4) ? bytes.between(1, k) : k;
        rows[p] = bytes.below(n);
        Grasp grasp = grasp_from(bytes, model, static_cast<int>(counts[p]));
        std::copy(grasp.points.begin(), grasp.points.end(), points.begin() + 3 * k * p);
        std::copy(grasp.rotations.begin(), grasp.rotations.end(), rotations.begin() + 9 * k * p);
        arms[p] = grasp.kind == Kind::garbage ? bytes.hostile() : grasp.arm;
        grasps.push_back(std::move(grasp));
    }
    for (Numbers* some : {&wrenches, &local, &capacities, &jacobians, &bias})
        for (double& one : *some) one = bytes.spread(1.0);
    if (bytes.once_in(8)) bytes.spoil(local);
    std::vector<unsigned char> borne(2 * n * m + 1);
    Numbers change(n * k * d * m), apart(n * k * d * m), offsets(n * k), multiples(n * m), tau(n * joints), most(tau);
    const Springs springs{k,           d, m, torsion, points.data(), rotations.data(), counts.data(), arms.data(),
                          wrenches.data()};
    bool* flags = reinterpret_cast<bool*>(borne.data());
    const Reactions whole{k, d, m, change.data(), flags, counts.data(), rows.data()},
        spread{k, d, m, apart.data(), flags + n * m, counts.data(), rows.data()};
    SpringBalance(springs, whole).alike(0, n);
    SpringBalance(springs, spread).spread(0, n, whole, capacities.data());
    const double limits[3] = {bytes.from(0.1, 1.0), limits[0], 0.01},
                 facets[12] = {1.4, 0.0, 0.0, -1.4, 0.0, 0.0, 0.0, 1.4, 0.0, 0.0, -1.4, 0.0};
    const Limits friction{model.round, model.round ? 0 : 12 / (d - 1), limits, facets};
    find_offsets(spread, friction, 0, n, bytes.once_in(2) ? local.data() : nullptr, shares.data(), offsets.data());
    find_multiples(spread, friction, 0, n, local.data(), multiples.data());
    Efforts efforts{joints,       rows.data(), jacobians.data(), rotations.data(), bias.data(), local.data(),
                    tau.data(), most.data()};
    find_efforts(whole, 0, n, efforts);
    for (int p = 0; p < n; ++p) {
        place = "springs, problem " + std::to_string(p) + ", " + kinds[int(grasps[p].kind)];
        for (int i = static_cast<int>(counts[p]); i < k; ++i)
            if (norm(change.data() + (p * k + i) * d * m, d * m) != 0.0) fail("contacts that do not count react");
        if (grasps[p].kind != Kind::reasonable) continue;
        for (const Reactions* own : {&whole, &spread})
            for (int l = 0; l < m; ++l) {
                if (!own->borne[p * m + l]) continue;
                // The balance, written out.
                double left[6], size = 0.0;
                for (int r = 0; r < 6; ++r) left[r] = wrenches[r * m + l] / (r < 3 ? 1.0 : arms[p]);
                size = norm(left, 6);
                for (int i = 0; i < counts[p]; ++i) {
                    const double *R = rotations.data() + 9 * (p * k + i), *at = points.data() + 3 * (p * k + i);
                    double f[4], force[3], moment[3];
                    for (int j = 0; j < d; ++j) f[j] = own->change[((p * k + i) * d + j) * m + l];
                    for (int r = 0; r < 3; ++r) force[r] = R[3 * r] * f[0] + R[3 * r + 1] * f[1] + R[3 * r + 2] * f[d - 1];
                    cross(at, force, moment);
                    for (int r = 0; r < 3; ++r) {
                        left[r] += force[r];
                        left[3 + r] += (moment[r] + (d == 4 ? R[3 * r + 2] * f[2] : 0.0)) / arms[p];
                    }
                }
                if (!(norm(left, 6) <= 2e-6 * size)) fail("%g of %g are not balanced", norm(left, 6), size);
            }
    }
}

// -- a squeeze that follows what is felt ------------------------------------------------------------------------------

void run_grip(Bytes& bytes) {
    const Grasp grasp = grasp_from(bytes, models[bytes.below(5)]);
    const int k = grasp.k, n = bytes.between(0, 6);
    const bool garbage = grasp.kind == Kind::garbage;
    OnlineSetup online;
    online.contacts = k;
    online.components = grasp.model.d;
    online.round = grasp.model.round;
    online.moments = grasp.moments;
    online.torsion = grasp.torsion;
    online.arm = grasp.arm;
    if (fault_of(online) != nullptr) return;
    const auto loop = make_online(online);
    std::copy(grasp.points.begin(), grasp.points.end(), loop->points);
    std::copy(grasp.rotations.begin(), grasp.rotations.end(), loop->rotations);
    GripSetup setup;
    setup.latency = bytes.from(0.0, 0.1);
    setup.margin = bytes.from(1.0, 2.0);
    setup.kept = bytes.share();
    setup.unfelt = bytes.from(0.0, 2.0);
    setup.jump = bytes.from(1.0, 3.0);
    setup.tells_load = bytes.once_in(2);
    setup.planned.assign(3 * k, 0.0);
    setup.most.assign(k, 0.0);
    setup.mu.assign(k, 0.0);
    for (int i = 0; i < k; ++i) {
        setup.planned[3 * i + 2] = bytes.from(0.0, 5.0);
        setup.most[i] = setup.planned[3 * i + 2] * bytes.from(1.0, 4.0);
        setup.mu[i] = bytes.share();
    }
    const auto fill = [&bytes](Numbers& values, std::size_t count, double size) {
        values.assign(count, 0.0);
        for (double& one : values) one = bytes.spread(size);
    };
    fill(setup.grasp_map, 18 * k, 1.0);
    fill(setup.internal, 9 * k * k, 1.0 / k);
    fill(setup.joint_map, 3 * k * n, 0.1);
    fill(setup.from_torques, 3 * k * n, 10.0);
    fill(setup.bias, n, 0.1);
    fill(setup.torque_limit, n, 1.0);
    for (double& one : setup.torque_limit) one = std::fabs(one);
    std::copy_n(grasp.load.data(), 6, setup.load);
    if (garbage) {
        for (Numbers* some : {&setup.planned, &setup.grasp_map, &setup.internal, &setup.most, &setup.mu})
            if (bytes.once_in(3)) bytes.spoil(*some);
        if (bytes.once_in(3)) setup.latency = bytes.hostile();
        if (bytes.once_in(3)) bytes.spoil(setup.load, 6);
    }
    if (fault_of(setup, online) != nullptr) {
        ++refused;
        return;
    }
    Grip grip(*loop, setup);
    Numbers felt(std::max({3 * k, n, 6}));
    double now = 0.0;
    for (int left = bytes.between(1, 60); left > 0; --left) {
        now += bytes.once_in(16) ? bytes.hostile() : 1e-3;
        for (int which = 0; which < feelings; ++which) {
            if (bytes.once_in(3)) continue;
            const Feeling kind = static_cast<Feeling>(which);
            for (double& one : felt) one = bytes.spread(bytes.once_in(8) ? 1e4 : 5.0);
            if (bytes.once_in(8)) bytes.spoil(felt);
            const double time = bytes.once_in(8) ? bytes.hostile() : now - bytes.from(0.0, 0.05);
            without_memory("Grip::feel", [&] { return grip.feel(kind, felt.data(), time); });
        }
        without_memory("Grip::tick", [&] { return grip.tick(now); });
        if (!std::isfinite(now)) now = 0.0;
        place = "grip, " + std::string(kinds[int(grasp.kind)]);
        if (!finite(grip.forces, 3 * k) || !finite(grip.torques, n) || !finite(grip.load, 6))
            fail("a command that is none: %g, %g, %g", norm(grip.forces, 3 * k), norm(grip.torques, n), norm(grip.load, 6));
        for (int i = 0; i < k; ++i) {
            const double planned = setup.planned[3 * i + 2];
            if (!(grip.forces[3 * i + 2] <= std::max(setup.most[i], planned) + 1e-9 * (1.0 + setup.most[i])))
                fail("%g N, with a cap of %g", grip.forces[3 * i + 2], setup.most[i]);
        }
        for (int j = 0; j < n; ++j)
            if (!(std::fabs(grip.torques[j]) <= setup.torque_limit[j])) fail("a torque beyond its limit");
    }
}

// -- least squares in a box -------------------------------------------------------------------------------------------

template <int M>
void run_box(Bytes& bytes) {
    const int n = bytes.between(1, 40);
    const bool garbage = bytes.once_in(4);
    const double size = std::pow(10.0, bytes.between(-3, 3));
    double eps = std::pow(10.0, bytes.between(-8, 0)) * size * size;
    Numbers H(M * n), b(M), k(n, none);
    for (double& one : H) one = bytes.once_in(8) ? 0.0 : bytes.spread(size);
    if (bytes.once_in(4))  // columns that coincide
        for (int r = 0; r < M; ++r)
            for (int j = 1; j < n; ++j) H[r * n + j] = H[r * n];
    if (garbage) bytes.spoil(H);
    if (garbage && bytes.once_in(4)) eps = bytes.hostile();
    BoxLeastSquares<M> method(H.data(), n, eps);
    for (int again = 0; again < 3; ++again) {
        for (double& one : b) one = bytes.spread(size * std::pow(10.0, bytes.between(-1, 1)));
        if (garbage) bytes.spoil(b);
        const bool found = without_memory("BoxLeastSquares::solve", [&] { return method.solve(b.data(), k.data()); });
        ++boxes.at[found ? 0 : 1];
        if (!found) continue;
        for (double one : k)
            if (!(std::fabs(one) <= 1.0)) fail("%g is out of the box", one);
        if (garbage) continue;
        // Its gap, from the residual as the multipliers.
        double y[M], gap = 0.0, about = 0.0;
        for (int r = 0; r < M; ++r) {
            y[r] = b[r];
            for (int j = 0; j < n; ++j) y[r] += H[r * n + j] * k[j];
            gap += y[r] * y[r] - y[r] * b[r];
            about += y[r] * y[r] + b[r] * b[r];
        }
        for (int j = 0; j < n; ++j) {
            double s = 0.0;
            for (int r = 0; r < M; ++r) s += H[r * n + j] * y[r];
            const double other = std::min(std::max(-s / eps, -1.0), 1.0);
            gap += 0.5 * eps * (k[j] * k[j] - other * other) - s * other;
            about += eps;
        }
        // Residuals of 1e-12 relative to 1 + |b| are let through.
        double slack = 0.0;
        for (double one : H) slack += std::fabs(one);
        slack = 1e-11 * (slack + norm(b.data(), M)) * (1.0 + norm(b.data(), M)) * (1.0 + size);
        if (!(gap <= 1e-6 * about + slack)) fail("gap %g of %g, eps %g", gap, about, eps);
    }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    Bytes bytes(data, size);
    const int entry = bytes.below(18);
    if (entry < 6) {
        place = "ticks";
        Ticks(bytes).run();
    } else if (entry < 13) {
        const bool compare = entry >= 9;
        Case own(bytes, compare);
        place = std::string(compare ? "comparison, " : "forces, ") + kinds[int(own.grasp.kind)];
        if (own.forces == nullptr) return 0;
        answer_case(own, compare);
        solve_case(bytes, own);
    } else if (entry < 15) {
        place = "batch";
        run_batch(bytes);
    } else if (entry == 17) {
        place = "grip";
        run_grip(bytes);
    } else if (entry == 16) {
        place = "springs";
        run_springs(bytes);
    } else {
        place = "box";
        if (bytes.once_in(2))
            run_box<3>(bytes);
        else
            run_box<6>(bytes);
    }
    return 0;
}

#ifndef WITH_LIBFUZZER
int main(int count, char** arguments) {
    if (count < 3) return std::fprintf(stderr, "usage: hostile seed count [seconds]\n"), 2;
#ifdef WITH_SANITIZER
    __sanitizer_set_death_callback(tell);
#endif
    const unsigned long long first = std::strtoull(arguments[1], nullptr, 10),
                             most = std::strtoull(arguments[2], nullptr, 10);
    const double seconds = count > 3 ? std::atof(arguments[3]) : infinity;
    const auto begun = std::chrono::steady_clock::now();
    const auto spent = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count(); };
    unsigned long long done = 0;
    double slowest = 0.0, before = 0.0;
    unsigned long long slow = 0;
    for (; done < most && before < seconds; ++done) {
        input = first + done;
        std::mt19937_64 random(input);
        // Often too few bytes: the others follow from them.
        std::vector<std::uint8_t> data(random() % 1024);
        for (std::uint8_t& one : data) one = static_cast<std::uint8_t>(random() >> 32);
        LLVMFuzzerTestOneInput(data.data(), data.size());
        const double now = spent();
        if (now - before > slowest) {
            slowest = now - before;
            slow = input;
        }
        before = now;
    }
    std::printf("%llu inputs in %.1f s, %d lanes; the slowest, %llu, took %.1f ms\n", done, spent(), width, slow,
                1e3 * slowest);
    for (const Counts* one : {&ticks, &answers, &solved, &batched, &searched, &boxes})
        std::printf("%-20s converged %lld, infeasible %lld, stalled %lld, unusable %lld\n", one->name, one->at[0],
                    one->at[2], one->at[1], one->at[3]);
    std::printf("%-20s %lld\n", "set-ups refused", refused);
    std::printf("%-20s %lld; proofs %lld, of loads %lld; compared %lld, too near to tell %lld\n", "certified", certified,
                proofs, proven_loads, compared, borderline);
    return 0;
}
#endif
