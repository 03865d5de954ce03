// Marks the scalar functions that CPU kernels and CUDA kernels share.
#pragma once

#ifdef __CUDACC__
#define FEWRAYS_HD __host__ __device__
#define FEWRAYS_WIDE alignas(16)  // loaded four numbers at a time
#else
#define FEWRAYS_HD
#define FEWRAYS_WIDE
#endif
