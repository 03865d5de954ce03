"""Open Image Denoise, the peer that fewrays is measured against.

It sees what a renderer's user gives it: the box image of the same samples, linear and HDR. It runs at its
best quality; auxiliary images are left out because inside defocus they are as noisy as the colours.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from fewrays.method import Image

__all__ = ["DENOISER", "denoise", "denoise_filter", "require_bench"]

DENOISER = "Open Image Denoise"


def require_bench() -> None:
    """Exit with the command that installs what the benchmarks need, unless it is there.

    Raises
    ------
    SystemExit
        When a package of ``fewrays[bench]`` is missing.
    """
    for module in ("pyoidn", "flip_evaluator", "skimage"):
        try:
            importlib.import_module(module)
        except ImportError as error:
            raise SystemExit(
                f'the benchmarks need {module} ({error}): pip install "fewrays[bench]"'
            ) from None


def denoise(image: Image) -> Image:
    """Denoise a linear HDR image ``(H, W, 3)`` at high quality."""
    result = _pyoidn().denoise(np.ascontiguousarray(image), hdr=True, quality="high")
    return cast(Image, result)


def denoise_filter(image: Image, threads: int | None) -> Callable[[], object]:
    """Set a denoiser up for one image, so that its execution can be timed alone.

    Parameters
    ----------
    image : ndarray, (H, W, 3)
        Linear radiance, float32.
    threads : int or None
        Threads that the denoiser may use; all cores when None.

    Returns
    -------
    callable
        Runs the filter, as `denoise` would, on that image.

    Raises
    ------
    RuntimeError
        When Open Image Denoise reports a failure.
    """
    pyoidn = _pyoidn()
    device = pyoidn.Device()
    if threads is not None:
        device.set_int("numThreads", threads)
    device.commit()
    kept = pyoidn.Filter(device, "RT")
    color, output = np.ascontiguousarray(image), np.empty_like(image)
    kept.set_image("color", color, pyoidn.OIDN_FORMAT_FLOAT3)
    kept.set_image("output", output, pyoidn.OIDN_FORMAT_FLOAT3)
    kept.set_bool("hdr", True)
    kept.set_quality(pyoidn.OIDN_QUALITY_HIGH)
    kept.commit()

    def execute() -> Image:
        kept.execute()
        problem = device.get_error()
        if problem is not None:
            raise RuntimeError(f"{DENOISER}: {problem}")
        return output

    return execute


def _pyoidn() -> Any:
    return importlib.import_module("pyoidn")
