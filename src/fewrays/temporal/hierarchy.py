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
_MOST_BUCKETS = 65536  # along an axis
_GUARD = 256.0  # pixels around the image within which buckets are told apart


class Hierarchy:
    """A search tree over the samples of a buffer.

    Parameters
    ----------
    samples : SampleBuffer
        Read in place: the tree stores numbers of samples and bounds.
    rule : SurfaceRule
        Which samples may share a leaf.
    spacing : ndarray of float32, (N,), optional
        How far samples are apart, for light fields that are no image, where pixels mean nothing; 0 for those
        that do not count.
    """

    def __init__(
        self, samples: SampleBuffer, rule: SurfaceRule, spacing: npt.NDArray[np.float32] | None = None
    ) -> None:
        pixel = 1.0 if spacing is None else float(np.median(spacing[spacing > 0]))
        left, top, right, bottom = _screen(samples) if spacing is None else _surroundings(samples, pixel)
        self.native = _native.SampleTree(
            view_light_field(samples, spacing),
            _native.TreeRule(
                bin=_BIN * pixel,
                most_samples=_BUCKET,
                along_lens=rule.along_lens,
                along_time=rule.along_time,
                tolerance=rule.tolerance * pixel,
                left=left,
                right=right,
                top=top,
                bottom=bottom,
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


def _screen(samples: SampleBuffer) -> tuple[float, float, float, float]:
    return -_GUARD, -_GUARD, samples.width + _GUARD, samples.height + _GUARD


def _surroundings(samples: SampleBuffer, unit: float) -> tuple[float, float, float, float]:
    """Return the box around the samples' median in which buckets are told apart, as far as these go."""
    x, y = np.median(samples.xy.reshape(-1, 2), axis=0)
    reach = _MOST_BUCKETS / 2 * _BIN * unit
    return float(x - reach), float(y - reach), float(x + reach), float(y + reach)
