// Kernels as phases over the threads of a block, which run on a GPU and, for tests, on a CPU.
//
// A kernel is a function of its arguments, its block, and the memory that the block's threads share: a structure, and
// for some as many words besides as their launch asks for. What a kernel does is
// divided into phases: block.each(phase) runs phase(thread) for every thread and returns when all are done. The GPU
// runs them at once, with a barrier behind. The CPU runs one after the other, in an order that tests choose: a phase
// that reads what another thread writes in the same phase shows by results that change with the order. Everything
// outside of phases must be the same for all threads.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#include "../math/host_device.h"

namespace fewrays {

// For kernels whose threads share nothing.
struct NothingShared {};

// A word of memory that holds a whole number at one time and a fraction at another.
union SharedWord {
    std::uint32_t whole;
    float real;
};

#ifdef __CUDACC__

struct Block {
    int x() const { return static_cast<int>(blockIdx.x); }
    int y() const { return static_cast<int>(blockIdx.y); }
    int z() const { return static_cast<int>(blockIdx.z); }

    template <typename Phase>
    void each(Phase&& phase) const {
        phase(static_cast<int>(threadIdx.x));
        __syncthreads();
    }

    // Whether the phase returns true for any thread.
    template <typename Phase>
    bool any(Phase&& phase) const {
        return __syncthreads_or(phase(static_cast<int>(threadIdx.x))) != 0;
    }
};

// A value that each thread keeps from phase to phase.
template <typename T, int threads>
struct Own {
    T value;
    T& operator[](int) { return value; }
};

#define FEWRAYS_KERNEL(name, threads, Arguments, Shared)                                                      \
    extern "C" __global__ void __launch_bounds__(threads) name(const __grid_constant__ Arguments arguments) { \
        __shared__ Shared shared;                                                                             \
        fewrays::run_##name(arguments, fewrays::Block{}, shared);                                             \
    }

// Of a kernel whose threads need many registers: they get them, for fewer threads at once.
#define FEWRAYS_KERNEL_WITH_REGISTERS(name, threads, Arguments, Shared)                                          \
    extern "C" __global__ void __launch_bounds__(threads, 1) name(const __grid_constant__ Arguments arguments) { \
        __shared__ Shared shared;                                                                                \
        fewrays::run_##name(arguments, fewrays::Block{}, shared);                                                \
    }

// Of a kernel that takes more shared memory, of a size that its launch says: so much that a multiprocessor has room for
// one block, which may have all registers.
#define FEWRAYS_KERNEL_WITH_WORDS(name, threads, Arguments, Shared)                                              \
    extern "C" __global__ void __launch_bounds__(threads, 1) name(const __grid_constant__ Arguments arguments) { \
        extern __shared__ fewrays::SharedWord words[];                                                           \
        __shared__ Shared shared;                                                                                \
        fewrays::run_##name(arguments, fewrays::Block{}, shared, words);                                         \
    }

#else

// The i-th of `count` in one of several orders: forwards, backwards, and jumping about.
inline int in_order(int i, int count, int order) {
    if (order == 0) return i;
    if (order == 1) return count - 1 - i;
    const std::int64_t stride = count % 7919 != 0 ? 7919 : 7907;  // primes
    return static_cast<int>((i * stride + order) % count);
}

class Block {
public:
    Block(int x, int y, int z, int threads, int order) : x_(x), y_(y), z_(z), threads_(threads), order_(order) {}

    int x() const { return x_; }
    int y() const { return y_; }
    int z() const { return z_; }

    template <typename Phase>
    void each(Phase&& phase) const {
        for (int i = 0; i < threads_; ++i) phase(in_order(i, threads_, order_));
    }

    template <typename Phase>
    bool any(Phase&& phase) const {
        bool result = false;
        each([&](int thread) { result = phase(thread) || result; });
        return result;
    }

private:
    int x_, y_, z_, threads_, order_;
};

template <typename T, int threads>
struct Own {
    T values[threads];
    T& operator[](int thread) { return values[thread]; }
};

// Runs all blocks of a grid. What threads share holds no zeros at first, as on a GPU.
template <typename Arguments, typename Shared, typename Kernel>
void run_grid(Kernel kernel, const Arguments& arguments, int threads, int columns, int rows, int layers, int order,
              int shared_bytes) {
    static Shared shared;
    std::vector<SharedWord> words(static_cast<std::size_t>(shared_bytes) / sizeof(SharedWord));
    const int count = columns * rows * layers;
    for (int i = 0; i < count; ++i) {
        const int at = in_order(i, count, order);
        std::memset(static_cast<void*>(&shared), 0xcd, sizeof shared);
        std::fill(words.begin(), words.end(), SharedWord{0xcdcdcdcd});
        const Block block(at % columns, at / columns % rows, at / columns / rows, threads, order);
        if constexpr (requires { kernel(arguments, block, shared, words.data()); })
            kernel(arguments, block, shared, words.data());
        else
            kernel(arguments, block, shared);
    }
}

#define FEWRAYS_KERNEL(name, threads, Arguments, Shared)                                                             \
    extern "C" void name(const Arguments* arguments, int columns, int rows, int layers, int order, int bytes) {      \
        fewrays::run_grid<Arguments, Shared>(fewrays::run_##name, *arguments, threads, columns, rows, layers, order, \
                                             bytes);                                                                 \
    }                                                                                                                \
    extern "C" int name##_threads() { return threads; }                                                              \
    extern "C" int name##_argument_bytes() { return static_cast<int>(sizeof(Arguments)); }
#define FEWRAYS_KERNEL_WITH_REGISTERS FEWRAYS_KERNEL
#define FEWRAYS_KERNEL_WITH_WORDS FEWRAYS_KERNEL

#endif

}  // namespace fewrays
