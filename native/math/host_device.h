// Marks the scalar functions that CPU kernels and CUDA kernels share.
#pragma once

#ifdef __CUDACC__
#define FEWRAYS_HD __host__ __device__
#else
#define FEWRAYS_HD
#endif
