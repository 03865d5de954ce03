"""How far an image is from its reference.

Images are linear, scene-referred RGB ``(H, W, 3)`` without a natural maximum, and what a viewer sees is a
display's version of them. The measures therefore come in two kinds:

- on radiance: `psnr` (against a stated peak) and `relmse`, which weighs dark and bright parts alike;
- on what a display shows, radiance clipped to ``[0, 1]`` and encoded: `psnr_display` (gamma 2.2, the
  project's main figure), `ssim` (gamma 2.2) and `flip` (sRGB).

SSIM and FLIP come from scikit-image and from FLIP's authors: ``pip install "fewrays[metrics]"``.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.color import gamma_encode, srgb_encode
from fewrays.errors import SampleError, first_index
from fewrays.method import Image

__all__ = [
    "Comparison",
    "compare",
    "error_heatmap",
    "flip",
    "flip_map",
    "psnr",
    "psnr_display",
    "relmse",
    "ssim",
]

Floats = npt.NDArray[np.float64]

_RELMSE_FLOOR = 0.01
_SSIM_WINDOW = 11  # pixels a side of SSIM's Gaussian window, σ = 1.5


@dataclass(frozen=True)
class Comparison:
    """What `compare` measured.

    Parameters
    ----------
    psnr : float
        Of linear radiance, in dB; higher is better.
    psnr_display : float
        After clip to ``[0, 1]`` and gamma 2.2, in dB; higher is better.
    relmse : float
        Relative mean squared error of radiance; 0 is best.
    ssim : float or None
        Structural similarity of the displayed images; 1 is best. None without ``fewrays[metrics]``, and for
        images smaller than SSIM's window of 11 pixels.
    flip : float or None
        Mean FLIP of the displayed images, in ``[0, 1]``; 0 is best. None without ``fewrays[metrics]``.
    """

    psnr: float
    psnr_display: float
    relmse: float
    ssim: float | None
    flip: float | None

    def rows(self) -> list[tuple[str, str]]:
        """Names and formatted values, for tables."""
        formats = {"psnr": "{:.2f} dB", "psnr_display": "{:.2f} dB", "relmse": "{:.3g}"}
        names = {
            "psnr": "PSNR (linear)",
            "psnr_display": "PSNR (clip, gamma 2.2)",
            "relmse": "relMSE",
            "ssim": "SSIM",
            "flip": "FLIP",
        }
        values = [(field.name, getattr(self, field.name)) for field in fields(self)]
        return [
            (names[name], "not available" if value is None else formats.get(name, "{:.4f}").format(value))
            for name, value in values
        ]

    def __str__(self) -> str:
        return "\n".join(f"{name:<24}{value:>14}" for name, value in self.rows())


def compare(image: npt.ArrayLike, reference: npt.ArrayLike, *, peak: float = 1.0) -> Comparison:
    """Measure an image by every metric that is installed.

    Parameters
    ----------
    image, reference : array_like, (H, W, 3)
        Linear radiance.
    peak : float
        For `psnr`.

    Returns
    -------
    Comparison
        ``print`` it for a table.

    Raises
    ------
    SampleError
        For shapes that differ or are not ``(H, W, 3)``, for NaN or infinities, and ``peak <= 0``.
    """
    image, reference = _checked(image, reference)
    large = min(image.shape[:2]) >= _SSIM_WINDOW
    return Comparison(
        psnr=psnr(image, reference, peak=peak),
        psnr_display=psnr_display(image, reference),
        relmse=relmse(image, reference),
        ssim=ssim(image, reference) if large and _is_installed("skimage.metrics") else None,
        flip=flip(image, reference) if _is_installed("flip_evaluator") else None,
    )


def psnr(image: npt.ArrayLike, reference: npt.ArrayLike, *, peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio of linear radiance in dB; ``inf`` for equal images.

    HDR radiance has no peak of its own. The default, 1, is the display's white, so that an error counts by
    its size on the scale that the viewer sees, even where a highlight is far brighter. For images in other
    units give the radiance that is to be shown as white. One bright pixel can rule this figure.

    Raises
    ------
    SampleError
        As `compare`.
    """
    image, reference = _checked(image, reference)
    if not (math.isfinite(peak) and peak > 0):
        raise SampleError(f"expected a positive, finite number, got {peak!r}", field="peak")
    error = float(np.square(image - reference).mean())
    return math.inf if error == 0 else 20 * math.log10(peak) - 10 * math.log10(error)


def psnr_display(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Peak signal-to-noise ratio in dB after clip to ``[0, 1]`` and gamma 2.2; ``inf`` for equal images.

    Raises
    ------
    SampleError
        As `compare`.
    """
    image, reference = _checked(image, reference)
    return psnr(gamma_encode(image), gamma_encode(reference))


def relmse(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Relative mean squared error: mean of ``(image - reference)² / (reference² + 0.01)`` over all channels.

    Raises
    ------
    SampleError
        As `compare`.
    """
    image, reference = _checked(image, reference)
    return float((np.square(image - reference) / (np.square(reference) + _RELMSE_FLOOR)).mean())


def ssim(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Structural similarity (Wang et al. 2004: Gaussian window, σ = 1.5) after clip and gamma 2.2.

    Raises
    ------
    SampleError
        As `compare`, and for images smaller than the window of 11 x 11 pixels.
    ImportError
        When scikit-image is not installed.
    """
    image, reference = _checked(image, reference)
    if min(image.shape[:2]) < _SSIM_WINDOW:
        raise SampleError(f"SSIM needs at least 11 x 11 pixels, got shape {image.shape}", field="image")
    metrics = _import("skimage.metrics")
    return float(
        metrics.structural_similarity(
            gamma_encode(reference),
            gamma_encode(image),
            data_range=1.0,
            channel_axis=-1,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )


def flip(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Mean of `flip_map`, in ``[0, 1]``.

    Raises
    ------
    SampleError, ImportError
        As `flip_map`.
    """
    return float(flip_map(image, reference).mean(dtype=np.float64))


def flip_map(image: npt.ArrayLike, reference: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Perceived difference of every pixel when the two images alternate on a display (LDR-FLIP).

    Both are clipped to ``[0, 1]`` and sRGB-encoded, and seen at the evaluator's default of 67 pixels per
    degree.

    Returns
    -------
    ndarray, (H, W)
        In ``[0, 1]``.

    Raises
    ------
    SampleError
        As `compare`.
    ImportError
        When flip-evaluator is not installed.
    """
    return np.asarray(_evaluate_flip(image, reference, magma=False)[..., 0], np.float32)


def error_heatmap(image: npt.ArrayLike, reference: npt.ArrayLike) -> Image:
    """Picture of `flip_map` in the magma colours, black for no difference to pale yellow.

    Returns
    -------
    ndarray, (H, W, 3)
        Display-referred sRGB in ``[0, 1]``: write it to a PNG without encoding it again.

    Raises
    ------
    SampleError, ImportError
        As `flip_map`.
    """
    return np.asarray(_evaluate_flip(image, reference, magma=True), np.float32)


def _evaluate_flip(image: npt.ArrayLike, reference: npt.ArrayLike, *, magma: bool) -> npt.NDArray[np.float32]:
    image, reference = _checked(image, reference)
    evaluator = _import("flip_evaluator")
    errors, _, _ = evaluator.evaluate(srgb_encode(reference), srgb_encode(image), "LDR", applyMagma=magma)
    result: npt.NDArray[np.float32] = errors
    return result


def _checked(image: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[Floats, Floats]:
    arrays = {"image": np.asarray(image), "reference": np.asarray(reference)}
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub" or array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
            raise SampleError(
                f"expected real numbers of shape (H, W, 3), got {array.dtype} of {array.shape}", field=name
            )
        finite = np.isfinite(array)
        if not finite.all():
            index = first_index(~finite)
            raise SampleError(
                f"{array.size - int(finite.sum())} of {array.size} values are NaN or infinite, the first at "
                f"{list(index)}: {array[index]}",
                field=name,
            )
    if arrays["image"].shape != arrays["reference"].shape:
        raise SampleError(
            f"shape {arrays['image'].shape} differs from the reference's {arrays['reference'].shape}",
            field="image",
        )
    return arrays["image"].astype(np.float64), arrays["reference"].astype(np.float64)


def _import(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(f'{module} is not installed; pip install "fewrays[metrics]" provides it') from error


def _is_installed(module: str) -> bool:
    try:
        importlib.import_module(module)
    except ImportError:
        return False
    return True
