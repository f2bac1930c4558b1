// The memory of a method: taken when it is set up, none after that.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "lanes.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// Arrays that are there as long as it is, aligned for lanes.
class Memory {
public:
    // `count` values of a type without constructor, all zero.
    template <class T>
    T* part(std::size_t count) {
        own_.emplace_back(new unsigned char[count * sizeof(T) + alignment]());
        const auto start = reinterpret_cast<std::uintptr_t>(own_.back().get());
        return reinterpret_cast<T*>(own_.back().get() + (alignment - start % alignment) % alignment);
    }

    double* copy(const double* values, std::size_t count) {
        double* found = part<double>(count);
        if (count > 0) std::memcpy(found, values, count * sizeof(double));
        return found;
    }

private:
    static constexpr std::size_t alignment = 64;
    std::vector<std::unique_ptr<unsigned char[]>> own_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
