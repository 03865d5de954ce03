#include "separable_blur.h"

namespace fewrays {
namespace {

// `rows_at_once` rows and `columns_at_once` columns: enough independent sums to hide the latency of a multiply-add.
template <int rows_at_once>
FEWRAYS_INLINE void blur_patch(const float* FEWRAYS_RESTRICT in, std::ptrdiff_t row_step, float* FEWRAYS_RESTRICT out,
                               std::ptrdiff_t out_stride, const float* FEWRAYS_RESTRICT taps,
                               const std::ptrdiff_t* FEWRAYS_RESTRICT offsets, int tap_count) {
    float sum[rows_at_once][columns_at_once] = {};
    for (int k = 0; k < tap_count; ++k) {
        const float* source = in + offsets[k];
        for (int row = 0; row < rows_at_once; ++row)
            for (int i = 0; i < columns_at_once; ++i) sum[row][i] += taps[k] * source[row * row_step + i];
    }
    for (int row = 0; row < rows_at_once; ++row)
        for (int i = 0; i < columns_at_once; ++i) out[row * out_stride + i] = sum[row][i];
}

}  // namespace

FEWRAYS_CLONES void blur_pass(const float* FEWRAYS_RESTRICT in, std::ptrdiff_t row_step, float* FEWRAYS_RESTRICT out,
                              int rows, int columns, const float* FEWRAYS_RESTRICT taps,
                              const std::ptrdiff_t* FEWRAYS_RESTRICT offsets, int tap_count) {
    for (int column = 0; column < columns; column += columns_at_once) {
        int row = 0;
        for (; row + 4 <= rows; row += 4)
            blur_patch<4>(in + row * row_step + column, row_step, out + std::ptrdiff_t{row} * columns + column, columns,
                          taps, offsets, tap_count);
        for (; row < rows; ++row)
            blur_patch<1>(in + row * row_step + column, row_step, out + std::ptrdiff_t{row} * columns + column, columns,
                          taps, offsets, tap_count);
    }
}

}  // namespace fewrays
