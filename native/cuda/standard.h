// What kernels use of the C++ standard library. The run-time compiler for GPUs brings no headers, so that the lines
// that include them are left out of what it is given, and this comes first.
#pragma once

#define INFINITY __int_as_float(0x7f800000)

namespace std {

using int8_t = signed char;
using int16_t = short;
using int32_t = int;
using int64_t = long long;
using uint8_t = unsigned char;
using uint16_t = unsigned short;
using uint32_t = unsigned int;
using uint64_t = unsigned long long;
using size_t = decltype(sizeof(0));
using ptrdiff_t = long long;

inline float fabs(float x) { return ::fabsf(x); }
inline double fabs(double x) { return ::fabs(x); }
inline float sqrt(float x) { return ::sqrtf(x); }
inline double sqrt(double x) { return ::sqrt(x); }
inline float floor(float x) { return ::floorf(x); }
inline double floor(double x) { return ::floor(x); }
inline float ceil(float x) { return ::ceilf(x); }
inline double ceil(double x) { return ::ceil(x); }
inline float exp(float x) { return ::expf(x); }
inline double exp(double x) { return ::exp(x); }
inline double exp2(double x) { return ::exp2(x); }
inline float log(float x) { return ::logf(x); }
inline double log(double x) { return ::log(x); }
inline float log2(float x) { return ::log2f(x); }
inline double log2(double x) { return ::log2(x); }
inline double sin(double x) { return ::sin(x); }
inline double cos(double x) { return ::cos(x); }
inline double atan2(double y, double x) { return ::atan2(y, x); }
inline double hypot(double x, double y) { return ::hypot(x, y); }
inline float hypot(float x, float y) { return ::hypotf(x, y); }
inline float fmin(float a, float b) { return ::fminf(a, b); }
inline double fmin(double a, double b) { return ::fmin(a, b); }
inline float fmax(float a, float b) { return ::fmaxf(a, b); }
inline double fmax(double a, double b) { return ::fmax(a, b); }
inline float copysign(float size, float sign) { return ::copysignf(size, sign); }
inline double copysign(double size, double sign) { return ::copysign(size, sign); }

template <typename T>
constexpr const T& min(const T& a, const T& b) {
    return b < a ? b : a;
}
template <typename T>
constexpr const T& max(const T& a, const T& b) {
    return a < b ? b : a;
}
template <typename T>
constexpr const T& clamp(const T& x, const T& least, const T& most) {
    return x < least ? least : most < x ? most : x;
}

template <typename To, typename From>
constexpr To bit_cast(const From& from) {
    return __builtin_bit_cast(To, from);
}

inline void* memcpy(void* to, const void* from, size_t bytes) { return ::memcpy(to, from, bytes); }

}  // namespace std
