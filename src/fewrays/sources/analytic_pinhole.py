"""What a pinhole camera makes of a stack of planes: a picture with depth, as renderers write it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fewrays.dynamic.depth_layer import DepthLayer
from fewrays.lens import Lens
from fewrays.sources.analytic import Plane, reference, trace

__all__ = ["pinhole"]


def pinhole(planes: Sequence[Plane], lens: Lens, height: int, width: int, *, spp: int = 64) -> DepthLayer:
    """See a stack of planes from the centre of the lens.

    Parameters
    ----------
    planes : sequence of Plane
        As for `fewrays.sources.analytic.reference`; for the layer behind leave out those in front.
    lens : Lens
        Its aperture does not matter.
    height, width : int
        Image size in pixels.
    spp : int
        Places in each pixel that its colour is averaged over.

    Returns
    -------
    DepthLayer
        Colours are antialiased by a box of a pixel; depths are those at the pixels' centres.

    Raises
    ------
    SampleError
        As `fewrays.sources.analytic.reference`.

    Examples
    --------
    >>> from fewrays.sources.analytic import constant
    >>> float(pinhole([Plane(2.0, constant(0.5))], Lens(-4.0, 2.0), 4, 6).depth[0, 0])
    2.0
    """
    closed = lens.refocus(aperture_scale=0.0)
    color = reference(planes, closed, height, width, spp=spp, pixel_filter="box")
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = np.stack([columns, rows], axis=-1)
    return DepthLayer(color, trace(planes, closed, centres, np.zeros_like(centres))[1])
