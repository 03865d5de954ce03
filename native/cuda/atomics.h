// What threads of different blocks may do to the same number at once. All of it is on whole numbers and in any order
// the same: results do not change from run to run.
#pragma once

#include <algorithm>
#include <cstdint>

namespace fewrays {

#ifdef __CUDACC__

inline void atomic_least(std::uint64_t* number, std::uint64_t value) { atomicMin(number, value); }
inline void atomic_increase(std::uint64_t* number, std::uint64_t value) { atomicAdd(number, value); }
inline void atomic_increase(std::uint32_t* number, std::uint32_t value) { atomicAdd(number, value); }
inline void atomic_most(std::uint32_t* number, std::uint32_t value) { atomicMax(number, value); }
inline void atomic_most(std::uint64_t* number, std::uint64_t value) { atomicMax(number, value); }
inline void atomic_set(std::uint32_t* number, std::uint32_t bits) { atomicOr(number, bits); }
// Returns what the number was before, which depends on the order.
inline std::uint32_t atomic_add(std::uint32_t* number, std::uint32_t value) { return atomicAdd(number, value); }
// Returns a place in a list, of which only what all of them hold together is the same in any order.
inline std::uint32_t atomic_take(std::uint32_t* number) { return atomicAdd(number, 1u); }

#else

inline void atomic_least(std::uint64_t* number, std::uint64_t value) { *number = std::min(*number, value); }
inline void atomic_increase(std::uint64_t* number, std::uint64_t value) { *number += value; }
inline void atomic_increase(std::uint32_t* number, std::uint32_t value) { *number += value; }
inline void atomic_most(std::uint32_t* number, std::uint32_t value) { *number = std::max(*number, value); }
inline void atomic_most(std::uint64_t* number, std::uint64_t value) { *number = std::max(*number, value); }
inline void atomic_set(std::uint32_t* number, std::uint32_t bits) { *number |= bits; }
inline std::uint32_t atomic_add(std::uint32_t* number, std::uint32_t value) {
    const std::uint32_t before = *number;
    *number += value;
    return before;
}
inline std::uint32_t atomic_take(std::uint32_t* number) { return (*number)++; }

#endif

}  // namespace fewrays
