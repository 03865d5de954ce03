"""`reconstruct`: one entry point for every method."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, cast, overload

import numpy as np
import numpy.typing as npt

from fewrays import layered, layered_published, multiplane, temporal
from fewrays.baselines import axis_aligned, box, sheared
from fewrays.cuda.device import pick_device
from fewrays.cuda.samples import DeviceSamples
from fewrays.errors import SampleError
from fewrays.method import Image, Method, Reconstruction, make_options
from fewrays.parallel import Execution
from fewrays.samples import SampleBuffer
from fewrays.temporal.shading import shade

__all__ = ["METHODS", "fastest_device", "find_method", "reconstruct", "run_method", "shaded_for"]

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        multiplane.METHOD,
        layered.METHOD,
        temporal.METHOD,
        layered_published.METHOD,
        layered_published.AXIS_ALIGNED_METHOD,
        axis_aligned.METHOD,
        sheared.METHOD,
        box.METHOD,
    )
}
"""Every method by name, the best first."""


@overload
def reconstruct(
    samples: SampleBuffer | DeviceSamples,
    method: str = ...,
    *,
    device: str = ...,
    threads: int | None = ...,
    progress: bool = ...,
    aovs: Literal[False] = ...,
    shadows: bool = ...,
    output: str = ...,
    **options: Any,
) -> Image: ...
@overload
def reconstruct(
    samples: SampleBuffer | DeviceSamples,
    method: str = ...,
    *,
    device: str = ...,
    threads: int | None = ...,
    progress: bool = ...,
    aovs: Literal[True],
    shadows: bool = ...,
    output: str = ...,
    **options: Any,
) -> tuple[Image, dict[str, npt.NDArray[Any]]]: ...
def reconstruct(
    samples: SampleBuffer | DeviceSamples,
    method: str = "multiplane",
    *,
    device: str = "auto",
    threads: int | None = None,
    progress: bool = False,
    aovs: bool = False,
    shadows: bool = True,
    output: str = "host",
    **options: Any,
) -> Image | tuple[Image, dict[str, npt.NDArray[Any]]]:
    """Reconstruct the image that hundreds of samples per pixel would have given.

    Parameters
    ----------
    samples : SampleBuffer or fewrays.cuda.samples.DeviceSamples
        The samples, with the lens to integrate over; on the host, or in a GPU's memory for ``"cuda"``.
    method : str
        A name from `METHODS`.
    device : {"auto", "cpu", "reference", "cuda"}
        ``"cuda"`` is an NVIDIA GPU, which ``"auto"`` means where there is one and the method runs on it;
        ``"reference"`` runs the method's plain NumPy definition, slowly.
    threads : int, optional
        Threads to use; all usable cores when omitted. The result does not depend on it.
    progress : bool
        Show a progress bar on stderr for work over two seconds.
    aovs : bool
        Return the method's further outputs as well.
    shadows : bool
        Where samples come with light samples of area lights, reconstruct their light and shadow, as `shade`
        does; otherwise take the noisy radiance as it is.
    output : {"host", "device"}
        Where an image that a GPU makes is returned: copied to the host, or as a CuPy array, without waiting.
    **options
        Fields of the method's options, such as ``tile=32`` for ``"layered"``; see its options class.

    Returns
    -------
    image : ndarray, (H, W, 3)
        Linear radiance, float32.
    aovs : dict of str to ndarray
        Only with ``aovs=True``: arrays that start with ``(H, W)``.

    Raises
    ------
    SampleError
        For an unknown method, device or option, options out of range, and ``device="cuda"`` without a GPU.
    """
    chosen = find_method(method)
    own = make_options(chosen.options, options, f"method {chosen.name!r}")
    execution = Execution(
        device=device, threads=threads, progress=progress, aovs=aovs, shadows=shadows, output=output
    )
    result = run_method(samples, chosen, own, execution)
    return (result.image, result.aovs) if aovs else result.image


def find_method(name: str) -> Method:
    """Return the method of that name, or raise a `SampleError` that lists them."""
    try:
        return METHODS[name]
    except KeyError:
        raise SampleError(
            f"unknown method {name!r}; choose from {', '.join(METHODS)}", field="method"
        ) from None


def fastest_device(method: Method, asked: str) -> str:
    """Return the device that is asked for, of those that a method runs on, and what ``"auto"`` means."""
    if asked not in ("auto", *method.devices):
        raise SampleError(
            f"method {method.name!r} runs on {', '.join(method.devices)}; got {asked!r}", field="device"
        )
    return pick_device(method.devices, asked)


def run_method(
    samples: SampleBuffer | DeviceSamples, method: Method, options: Any, execution: Execution
) -> Reconstruction:
    """Run a method with its options object; ``device="auto"`` becomes the method's fastest device."""
    device = fastest_device(method, execution.device)
    if isinstance(samples, DeviceSamples) and device != "cuda":
        raise SampleError(
            f"are on a GPU, and method {method.name!r} on {device!r}: use device='cuda' with a method that "
            "knows it, or copy them with to_buffer()",
            field="samples",
        )
    if not isinstance(samples, (SampleBuffer, DeviceSamples)):
        raise SampleError(f"expected a fewrays.SampleBuffer, got {type(samples).__name__}", field="samples")
    if isinstance(samples, SampleBuffer):
        samples = shaded_for(method, samples, options, execution)
    result = method.run(samples, options, dataclasses.replace(execution, device=device))
    assert result.image.dtype == np.float32
    assert result.image.shape == (samples.height, samples.width, 3)
    return result


def shaded_for(method: Method, samples: SampleBuffer, options: Any, execution: Execution) -> SampleBuffer:
    """Return samples with light and shadow of their area lights reconstructed, unless the method does that.

    Without shadows they lose their lights instead, so that no method reads them.
    """
    if samples.lighting is None:
        return samples
    if not execution.shadows:
        return dataclasses.replace(samples, lighting=None)
    if method.reads_lights(options):
        return samples
    device = cast(Literal["auto", "cpu", "reference", "cuda"], execution.device)
    return shade(samples, device=device, threads=execution.threads, progress=execution.progress)
