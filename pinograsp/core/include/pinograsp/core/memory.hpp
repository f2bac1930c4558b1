// The memory of a method: taken once when it is set up, none after that.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "lanes.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// Hands out parts of one block of memory, all zero and aligned for lanes.
class Memory {
public:
    explicit Memory(std::size_t bytes) : bytes_(bytes + alignment), own_(new unsigned char[bytes_]()) {
        const auto start = reinterpret_cast<std::uintptr_t>(own_.get());
        next_ = own_.get() + (alignment - start % alignment) % alignment;
    }

    // Room for `count` values of a type without constructor. Sizes are summed up by `bytes_for`.
    template <class T>
    T* part(std::size_t count) {
        T* found = reinterpret_cast<T*>(next_);
        next_ += bytes_for<T>(count);
        return found;
    }

    template <class T>
    static constexpr std::size_t bytes_for(std::size_t count) {
        return (count * sizeof(T) + alignment - 1) / alignment * alignment;
    }

private:
    static constexpr std::size_t alignment = 64;
    std::size_t bytes_;
    std::unique_ptr<unsigned char[]> own_;
    unsigned char* next_ = nullptr;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
