"""The thin lens: from what people know about a camera to slopes in pixels.

A point at planar depth ``z`` that the lens centre sees at ``xy_centre`` is seen from the lens point
``(u, v)`` at ``xy_centre + C(z) * (u, v)``, with the *slope* ``C(z) = c0 / z + c1`` in pixels per unit of
lens coordinate. The rim of the lens is at ``|(u, v)| = 1``, so ``|C|`` is the radius of the circle of
confusion in pixels. ``C`` is negative in front of the focal plane and positive behind it.

For a camera with ``K`` pixels per unit of ``tan(angle)`` (the focal length in pixels), a lens of radius ``R``
and a focal plane at distance ``f``, similar triangles through the lens point give

    C(z) = K R (1/f - 1/z),    c0 = -K R,    c1 = K R / f.

The image of the lens centre does not depend on ``R`` or ``f``, so changing focus or aperture only changes
``c0`` and ``c1``: refocusing leaves the samples alone (temporal, section 6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError

__all__ = ["Lens", "LensAperture", "Sampling"]

LensAperture = Literal["disc", "gaussian"]
"""What a lens's image integrates over; `fewrays.aperture.Aperture` knows more shapes."""

Sampling = Literal["disc", "square", "gaussian"]
"""What the lens positions of samples were drawn from."""


@dataclass(frozen=True)
class Lens:
    """A thin lens in image units.

    Parameters
    ----------
    c0 : float
        Slope coefficient in pixels times depth units, at most 0.
    c1 : float
        Slope at infinite depth in pixels: the circle of confusion of the far background.
    aperture : {"disc", "gaussian"}
        What the image integrates over: a uniform disc of radius 1, or a Gaussian of standard deviation
        `sigma` per axis, cut off at the square ``[-1, 1]²``.
    sampling : {"disc", "square", "gaussian"}
        The density that the lens positions of the samples were drawn from: uniform over the unit disc,
        uniform over ``[-1, 1]²``, or the same Gaussian as above.
    sigma : float
        Standard deviation of the Gaussians, in lens units (lens radius = 1).

    Raises
    ------
    SampleError
        For coefficients that are not finite or beyond 1e30, ``c0 > 0``, an unknown aperture or sampling, or
        a `sigma` outside 0.001 to 1000.

    Examples
    --------
    >>> lens = Lens.thin_lens(640, focus_distance=2.0, lens_radius=0.05, fov=40.0)
    >>> round(float(lens.slope(4.0)), 2)
    10.99
    """

    c0: float
    c1: float
    aperture: LensAperture = "disc"
    sampling: Sampling = "disc"
    sigma: float = 1.0 / 3.0

    def __post_init__(self) -> None:
        for name in ("c0", "c1", "sigma"):
            value = getattr(self, name)
            try:
                number = float(value)
            except (TypeError, ValueError):
                raise SampleError(f"expected a number, got {value!r}", field=f"lens.{name}") from None
            if not abs(number) <= _LARGEST:
                raise SampleError(
                    f"expected a finite number up to {_LARGEST:g}, got {value!r}", field=f"lens.{name}"
                )
            object.__setattr__(self, name, number)
        if self.c0 > 0:
            raise SampleError(
                f"c0 = {self.c0:g} makes the slope fall with depth; with C = c0 / depth + c1 in pixels, "
                "c0 is at most 0 (negate u, v and both coefficients if your renderer mirrors the lens)",
                field="lens.c0",
            )
        least, most = _SIGMA_RANGE
        if not least <= self.sigma <= most:
            raise SampleError(
                f"expected a number from {least} to {most:g} lens radii, got {self.sigma:g}",
                field="lens.sigma",
            )
        for name, choices in (("aperture", get_args(LensAperture)), ("sampling", get_args(Sampling))):
            value = getattr(self, name)
            if value not in choices:
                raise SampleError(
                    f"expected one of {', '.join(choices)}; got {value!r}", field=f"lens.{name}"
                )

    @classmethod
    def thin_lens(
        cls,
        image_width: int,
        *,
        focus_distance: float,
        fov: float | None = None,
        focal_length: float | None = None,
        sensor_width: float = 36.0,
        lens_radius: float | None = None,
        f_number: float | None = None,
        units_per_metre: float = 1.0,
        aperture: LensAperture = "disc",
        sampling: Sampling = "disc",
        sigma: float = 1.0 / 3.0,
    ) -> Lens:
        """Build a lens from a camera's data.

        Give the angle of view as `fov`, or as `focal_length` and `sensor_width`; give the aperture as
        `lens_radius` (Mitsuba's ``aperture_radius``, pbrt's ``lensradius``), or as `f_number` together with
        `focal_length`. Like those renderers, the angle of view does not change with the focus distance.

        Parameters
        ----------
        image_width : int
            Image width in pixels.
        focus_distance : float
            Depth of the focal plane in scene units; ``inf`` is allowed.
        fov : float, optional
            Horizontal angle of view in degrees.
        focal_length, sensor_width : float, optional
            In millimetres; `sensor_width` is 36 (full frame) unless given.
        lens_radius : float, optional
            Radius of the lens in scene units.
        f_number : float, optional
            Focal length over aperture diameter.
        units_per_metre : float
            Scene units in one metre; converts the millimetres of `focal_length` for `f_number`.
        aperture, sampling, sigma
            As in the class.

        Returns
        -------
        Lens

        Raises
        ------
        SampleError
            When the numbers do not determine a lens or are out of range.
        """
        _require_positive(image_width=image_width, focus_distance=focus_distance, sensor_width=sensor_width)
        _require_positive(units_per_metre=units_per_metre)
        for name, value in (("fov", fov), ("focal_length", focal_length), ("f_number", f_number)):
            if value is not None:
                _require_positive(**{name: value})

        if (fov is None) == (focal_length is None):
            raise SampleError("give either fov or focal_length (with sensor_width)", field="fov")
        if fov is not None:
            if fov >= 180:
                raise SampleError(f"expected less than 180 degrees, got {fov:g}", field="fov")
            pixels = 0.5 * image_width / math.tan(math.radians(fov) / 2)
        else:
            assert focal_length is not None
            pixels = image_width * focal_length / sensor_width

        if (lens_radius is None) == (f_number is None):
            raise SampleError("give either lens_radius or f_number", field="lens_radius")
        if lens_radius is None:
            if focal_length is None:
                raise SampleError("f_number needs focal_length, not fov", field="f_number")
            assert f_number is not None
            lens_radius = focal_length / (2 * f_number) / 1000 * units_per_metre
        elif not (math.isfinite(lens_radius) and lens_radius >= 0):
            raise SampleError(f"expected a finite number >= 0, got {lens_radius!r}", field="lens_radius")

        blur = pixels * lens_radius
        return cls(-blur, blur / focus_distance, aperture, sampling, sigma)

    @property
    def focus_distance(self) -> float:
        """Depth at which the slope is 0, in scene units; ``nan`` for a pinhole."""
        if self.c1 == 0:
            return math.inf if self.c0 else math.nan
        return -self.c0 / self.c1

    @property
    def gaussian_sigma(self) -> float:
        """Standard deviation of the Gaussian with the aperture's second moment, per axis, in lens units.

        A uniform unit disc has the second moment 1/4 along each axis, hence 1/2.
        """
        return self.sigma if self.aperture == "gaussian" else 0.5

    def slope(self, depth: npt.ArrayLike) -> npt.NDArray[np.floating]:
        """Signed circle-of-confusion radius at planar depths.

        Parameters
        ----------
        depth : array_like
            Planar depth in scene units, > 0. float32 stays float32, so that every engine puts a sample
            into the same layer; anything else is computed in float64.

        Returns
        -------
        ndarray
            ``c0 / depth + c1`` in pixels per unit of lens coordinate, with the shape of `depth`.
        """
        depth = np.asarray(depth)
        dtype = np.float32 if depth.dtype == np.float32 else np.float64
        coefficients = np.array([self.c0, self.c1], dtype)
        result: npt.NDArray[np.floating] = coefficients[0] / depth.astype(dtype, copy=False) + coefficients[1]
        return result

    def depth(self, slope: float) -> float:
        """Planar depth in scene units at which the slope is `slope` pixels; the inverse of `slope`.

        Raises
        ------
        SampleError
            For a slope that no positive depth has: at or beyond that of infinity, or of a pinhole.
        """
        if self.c0 == 0 or not slope < self.c1:
            raise SampleError(f"expected less than {self.c1:g} px, got {slope!r}", field="slope")
        return self.c0 / (slope - self.c1)

    def refocus(self, focus_distance: float | None = None, aperture_scale: float = 1.0) -> Lens:
        """Return the lens focused elsewhere or with its radius scaled.

        Parameters
        ----------
        focus_distance : float, optional
            New depth of the focal plane in scene units, ``inf`` allowed; unchanged when omitted.
        aperture_scale : float
            Factor on the lens radius, >= 0; 0 gives a pinhole.

        Returns
        -------
        Lens

        Raises
        ------
        SampleError
            For a focus distance that is not positive or a scale that is negative or not finite.
        """
        if not (math.isfinite(aperture_scale) and aperture_scale >= 0):
            raise SampleError(
                f"expected a finite number >= 0, got {aperture_scale!r}", field="aperture_scale"
            )
        c1 = self.c1
        if focus_distance is not None:
            _require_positive(focus_distance=focus_distance)
            c1 = -self.c0 / focus_distance
        return replace(self, c0=self.c0 * aperture_scale, c1=c1 * aperture_scale)

    def weights(self, uv: npt.ArrayLike) -> npt.NDArray[np.floating]:
        """Weight of samples at lens positions: aperture density over sampling density.

        Parameters
        ----------
        uv : array_like
            Lens positions ``(..., 2)``. float32 stays float32.

        Returns
        -------
        ndarray
            Shape ``(...)``. Its mean over samples drawn from `sampling` tends to 1 where `sampling` covers
            the aperture. A disc leaves out the corners of the square, which hold
            ``exp(-1 / (2 sigma²))`` of a Gaussian: 1.1 % at ``sigma = 1/3``.
        """
        if self.aperture == self.sampling:
            return np.ones_like(_radius_squared(uv))
        r2 = _radius_squared(uv)
        weights = self._density(self.aperture, r2) / self._density(self.sampling, r2)
        if self.aperture == "disc":
            weights = np.where(r2 <= 1 + _RIM, weights, np.zeros_like(weights))
        return weights

    def sampling_density(self, uv: npt.ArrayLike) -> npt.NDArray[np.floating]:
        """Probability density, per unit of lens area, that `sampling` has at lens positions ``(..., 2)``.

        The support is not tested: beyond its disc or square a density keeps its formula's value, so that a
        sample on the rim is not lost to rounding.
        """
        return self._density(self.sampling, _radius_squared(uv))

    def _density(
        self, shape: LensAperture | Sampling, r2: npt.NDArray[np.floating]
    ) -> npt.NDArray[np.floating]:
        if shape == "gaussian":
            inside = math.erf(1 / (self.sigma * math.sqrt(2)))
            norm = 1 / (2 * math.pi * self.sigma**2 * inside**2)
            density: npt.NDArray[np.floating] = norm * np.exp(-r2 / (2 * self.sigma**2))
            return density
        return np.full_like(r2, 1 / math.pi if shape == "disc" else 0.25)


_SIGMA_RANGE = (0.001, 1000.0)
_LARGEST = 1e30  # so that slopes can be computed in float32
_RIM = 1e-5  # positions this far beyond the rim still count as on the lens


def _radius_squared(uv: npt.ArrayLike) -> npt.NDArray[np.floating]:
    uv = np.asarray(uv)
    if uv.dtype != np.float32:
        uv = uv.astype(np.float64)
    r2: npt.NDArray[np.floating] = np.square(uv).sum(axis=-1)
    return r2


def _require_positive(**values: float) -> None:
    for name, value in values.items():
        if math.isnan(value) or value <= 0 or (math.isinf(value) and name != "focus_distance"):
            raise SampleError(f"expected a positive number, got {value!r}", field=name)
