// How far the light that samples were given is off what their own light samples brought, on the surfaces around each.
// Twin of src/fewrays/temporal/settle_reference.py.
#pragma once

namespace fewrays {

// N = H W S samples, those of a pixel side by side.
struct SettlePlan {
    int height, width, spp;
    const float* xy;                // (N, 2): image positions
    const float* at_center;         // (N, 2): where the lens centre sees what they hit
    const float* inverse_depth;     // (N)
    const float* inverse_gradient;  // (N, 2): its derivatives on the tangent plane, per pixel
    const float* normal;            // (N, 3)
    const float* light;             // (N): what the lamps would bring if nothing were in between
    const float* difference;        // (N): what the own light samples brought, less what was given
    float sigma;                    // of the Gaussian around a sample, in pixels
    float pixel;                    // its side at depth 1
};

// For the samples of rows [first, last) of the image: the mean difference around each, as a share of the mean light,
// and the variance of that share. Both are 0 where a sample gets no light. Where it has hardly any
// others on its surface, all may be noise: the variance is the share's square.
void settle_rows(const SettlePlan& plan, int first, int last, float* share, float* variance);

}  // namespace fewrays
