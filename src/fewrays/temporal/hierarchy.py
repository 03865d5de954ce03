"""The hierarchy that finds the samples seen near a place, whatever the lens point and time (section 4).

Samples are bucketed by where the lens centre sees them in the middle of the shutter. A quadtree divides the
buckets until few samples are left, those are cut where samples might cross, so that each leaf holds one
surface, and leaves are joined to a tree from below. Every node bounds its samples' places on the screen
between four planes, linear in lens coordinate and time (Eq. 6 and Appendix A). The tree itself is native: see
``native/sample_tree.h``.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.native_view import view_light_field
from fewrays.samples import SampleBuffer
from fewrays.temporal.plan import SurfaceRule

__all__ = ["Hierarchy"]

_BIN = 0.5  # side of the smallest buckets, in pixels
_BUCKET = 64  # samples of a bucket that is not divided
_GUARD = 256.0  # pixels around the image within which buckets are told apart


class Hierarchy:
    """A search tree over the samples of a buffer.

    Parameters
    ----------
    samples : SampleBuffer
        Read in place: the tree stores numbers of samples and bounds.
    rule : SurfaceRule
        Which samples may share a leaf.
    """

    def __init__(self, samples: SampleBuffer, rule: SurfaceRule) -> None:
        self.native = _native.SampleTree(
            view_light_field(samples),
            _native.TreeRule(
                bin=_BIN,
                most_samples=_BUCKET,
                along_lens=rule.along_lens,
                along_time=rule.along_time,
                tolerance=rule.tolerance,
                left=-_GUARD,
                right=samples.width + _GUARD,
                top=-_GUARD,
                bottom=samples.height + _GUARD,
            ),
        )

    @property
    def nbytes(self) -> int:
        """Bytes that the tree takes."""
        return self.native.nbytes

    @property
    def leaf_count(self) -> int:
        """Number of leaves."""
        return self.native.leaf_count

    def query(
        self, x: float, y: float, u: float, v: float, time: float, radius: float
    ) -> npt.NDArray[np.int32]:
        """Find the samples that are seen within `radius` pixels of a place from a lens point at a time.

        Returns
        -------
        ndarray of int32
            Indices into the flattened buffer, in no particular order.
        """
        return np.asarray(self.native.query(x, y, u, v, time, radius), np.int32)
