// Kernels as phases over the threads of a block, which run on a GPU and, for tests, on a CPU.
//
// A kernel is a function of its arguments, its block, and the memory that the block's threads share. What it does is
// divided into phases: block.each(phase) runs phase(thread) for every thread and returns when all are done. The GPU
// runs them at once, with a barrier behind. The CPU runs one after the other, in an order that tests choose: a phase
// that reads what another thread writes in the same phase shows by results that change with the order. Everything
// outside of phases must be the same for all threads.
#pragma once

#include <cstdint>
#include <cstring>

#include "../math/host_device.h"

namespace fewrays {

// For kernels whose threads share nothing.
struct NothingShared {};

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
void run_grid(Kernel kernel, const Arguments& arguments, int threads, int columns, int rows, int layers, int order) {
    static Shared shared;
    const int count = columns * rows * layers;
    for (int i = 0; i < count; ++i) {
        const int at = in_order(i, count, order);
        std::memset(static_cast<void*>(&shared), 0xcd, sizeof shared);
        kernel(arguments, Block(at % columns, at / columns % rows, at / columns / rows, threads, order), shared);
    }
}

#define FEWRAYS_KERNEL(name, threads, Arguments, Shared)                                                              \
    extern "C" void name(const Arguments* arguments, int columns, int rows, int layers, int order) {                  \
        fewrays::run_grid<Arguments, Shared>(fewrays::run_##name, *arguments, threads, columns, rows, layers, order); \
    }                                                                                                                 \
    extern "C" int name##_threads() { return threads; }                                                               \
    extern "C" int name##_argument_bytes() { return static_cast<int>(sizeof(Arguments)); }

#endif

}  // namespace fewrays
