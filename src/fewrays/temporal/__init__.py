"""Temporal light field reconstruction, after Lehtinen, Aila, Chen, Laine and Durand 2011.

Every pixel reads the light field at many locations: image position, lens point and time. At each, the
samples are seen from that lens point at that time (`reprojection`), those nearby are told apart into
surfaces, and the one that covers the location is filtered (`surfaces`). `reference` does that one location
after the other, in plain NumPy. The native engine goes view by view: all pixels of a tile share a lens point
and a time, so that one pass over the samples nearby serves all of them (`kernel`); `hierarchy` finds these
samples, and serves locations that have nothing in common. `locations` says where a pixel reads, `dispersion`
how far apart samples can be, and `refine` makes more of the result than its mean.

Light samples of area lights (`lamps`, `view_light`) are read in the same way (`shadows`): at the points that
locations see, as published, or at those of the samples themselves (`shading`), which serves every method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from fewrays.aperture_options import ApertureOptions
from fewrays.cuda.device import require_machine
from fewrays.cuda.machine import Machine
from fewrays.cuda.samples import DeviceSamples
from fewrays.errors import require_option
from fewrays.lighting import Lighting
from fewrays.method import Method, Reconstruction
from fewrays.parallel import Execution
from fewrays.pinhole import needs_order, with_order
from fewrays.pixel_filter import PixelFilter, PixelFilterShape
from fewrays.samples import SampleBuffer
from fewrays.temporal import cuda, cuda_refine, kernel, reference
from fewrays.temporal.cuda_dispersion import dispersion_on_card
from fewrays.temporal.cuda_mean import sample_mean_on_card
from fewrays.temporal.dispersion import dispersion
from fewrays.temporal.locations import make_locations
from fewrays.temporal.plan import Plan, SurfaceRule
from fewrays.temporal.refine import correct, sample_mean, smooth_bands
from fewrays.temporal.relighting_cuda import Relighting
from fewrays.temporal.shutter import Shutter, ShutterResponse

__all__ = ["METHOD", "TemporalOptions"]

_TILE = 32


@dataclass(frozen=True, kw_only=True)
class TemporalOptions(ApertureOptions):
    """Options of ``method="temporal"``."""

    locations: int = 128
    """Places at which every pixel reads the light field: time grows with them, noise shrinks."""
    pixel_filter: PixelFilterShape = "box"
    """Pixel filter."""
    sigma_pix: float = 0.5
    """Standard deviation of the Gaussian pixel filter, in pixels."""
    shutter: tuple[float, float] = (0.0, 1.0)
    """When the shutter opens and closes, in [0, 1] over the shutter of the samples."""
    shutter_response: ShutterResponse = "box"
    """How open the shutter is in between."""
    radius_scale: float = 1.7
    """Radius within which samples are gathered, in units of the largest hole that their pattern leaves."""
    tent_scale: float = 1.0
    """Radius of the tent filter over a surface, in units of that radius; 0 takes the nearest sample."""
    smoothing: float = 1.0
    """How much to smooth wide blur, in units of the noise that few locations leave there; 0 for none."""
    correction: float = 1.8
    """Scale in pixels on which the image is corrected towards the samples' own mean; 0 for none."""
    light_at: Literal["samples", "locations"] = "samples"
    """Where light of area lights is reconstructed: at the samples' own points, or at what locations see."""

    def __post_init__(self) -> None:
        require_option(
            "light_at", self.light_at, self.light_at in ("samples", "locations"), "'samples' or 'locations'"
        )
        require_option("locations", self.locations, 1 <= self.locations <= 65536, "from 1 to 65536")
        require_option("radius_scale", self.radius_scale, 0.25 <= self.radius_scale <= 8, "from 0.25 to 8")
        tent = self.tent_scale == 0 or 0.25 <= self.tent_scale <= 2
        require_option("tent_scale", self.tent_scale, tent, "0 or from 0.25 to 2")
        require_option("smoothing", self.smoothing, 0 <= self.smoothing <= 4, "from 0 to 4")
        require_option(
            "correction",
            self.correction,
            self.correction == 0 or 0.5 <= self.correction <= 16,
            "0 or from 0.5 to 16 px",
        )
        self.open_shutter()
        self.filter_of_pixels()
        super().__post_init__()

    def filter_of_pixels(self) -> PixelFilter:
        """Return the pixel filter."""
        return PixelFilter(self.pixel_filter, self.sigma_pix)

    def open_shutter(self) -> Shutter:
        """Return the shutter."""
        return Shutter(*self.shutter, self.shutter_response)


def make_plan(samples: SampleBuffer, options: TemporalOptions) -> Plan:
    """Lay out locations and measure what makes a surface."""
    return _plan_of(samples, options, dispersion(samples), samples.lighting)


def make_plan_on_card(
    machine: Machine,
    samples: DeviceSamples,
    options: TemporalOptions,
    *,
    timed: bool,
    lighting: Lighting | None = None,
) -> Plan:
    """Do the same for samples in a card's memory, and wait for it; `timed` tells whether anything moves."""
    return _plan_of(samples, options, dispersion_on_card(machine, samples, timed=timed), lighting)


def _plan_of(
    samples: SampleBuffer | DeviceSamples, options: TemporalOptions, hole: float, lighting: Lighting | None
) -> Plan:
    """Lay out locations, where the largest holes between samples have a radius of `hole` pixels."""
    return Plan(
        height=samples.height,
        width=samples.width,
        tile=_TILE,
        locations=make_locations(
            options.locations,
            options.aperture_of(samples.lens),
            options.filter_of_pixels(),
            options.open_shutter(),
        ),
        rule=SurfaceRule.for_holes(
            hole,
            options.locations,
            radius_scale=options.radius_scale,
            tent_scale=options.tent_scale,
        ),
        lighting=lighting if _reads_lights(options) else None,
    )


def _reads_lights(options: TemporalOptions) -> bool:
    return options.light_at == "locations"


_ENGINES: dict[str, Callable[[SampleBuffer, Plan, npt.NDArray[np.float32], Execution], object]] = {
    "cpu": kernel.reconstruct_tiles,
    "reference": reference.reconstruct_tiles,
}


def _run(
    samples: SampleBuffer | DeviceSamples, options: TemporalOptions, execution: Execution
) -> Reconstruction:
    if execution.device == "cuda":
        return _run_on_card(samples, options, execution)
    assert isinstance(samples, SampleBuffer)
    plan = make_plan(samples, options)
    bands = np.zeros((samples.height, samples.width, len(plan.band_starts), 4), np.float32)
    ordered = with_order(samples) if needs_order(samples) else samples
    _ENGINES[execution.device](ordered, plan, bands, execution)
    image = smooth_bands(bands, plan.band_starts, options.smoothing * plan.rule.along_lens)
    if options.correction and plan.lighting is None:  # whose shadows would bring their noise back
        aperture, shutter = options.aperture_of(samples.lens), options.open_shutter()
        mean = sample_mean(samples, aperture, options.filter_of_pixels(), shutter)
        image = correct(image, mean, options.correction)
    return Reconstruction(image)


def _run_on_card(
    samples: SampleBuffer | DeviceSamples, options: TemporalOptions, execution: Execution
) -> Reconstruction:
    machine = require_machine()
    # Motions of 0 are not copied to the card; their times count for the pattern nevertheless, as on the host.
    timed = samples.time is not None and samples.motion is not None
    if isinstance(samples, SampleBuffer) and samples.lighting is not None and _reads_lights(options):
        image = _reconstruct_lit(machine, samples, samples.lighting, options, timed=timed)
    else:
        on_card = samples if isinstance(samples, DeviceSamples) else DeviceSamples.of_buffer(machine, samples)
        image = reconstruct_on_card(machine, on_card, options, timed=timed)
    return Reconstruction(execution.deliver(machine, image))


def _reconstruct_lit(
    machine: Machine, samples: SampleBuffer, lighting: Lighting, options: TemporalOptions, *, timed: bool
) -> Any:
    """Make an image of what locations see, lit where it is, on the card; there is no correction."""
    on_card = DeviceSamples.of_buffer(machine, samples)
    plan = make_plan_on_card(machine, on_card, options, timed=timed, lighting=lighting)
    if needs_order(samples):
        samples = with_order(samples)
        on_card = DeviceSamples.of_buffer(machine, samples)
    relighting = Relighting(machine, samples, on_card, plan, lighting)
    return _image_of(machine, on_card, plan, options, relighting)


def reconstruct_on_card(
    machine: Machine, samples: DeviceSamples, options: TemporalOptions, *, timed: bool
) -> Any:
    """Make an image of samples in a card's memory, which it does not leave; the host waits once, for R.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    options : TemporalOptions
    timed : bool
        Whether times spread samples as lens points do: see `dispersion_on_card`.

    Returns
    -------
    array of float32, (H, W, 3)
        Linear radiance, on the card.
    """
    plan = make_plan_on_card(machine, samples, options, timed=timed)
    ordered = with_order(samples) if needs_order(samples) else samples
    image = _image_of(machine, ordered, plan, options)
    if not options.correction:
        return image
    aperture, shutter = options.aperture_of(samples.lens), options.open_shutter()
    mean = sample_mean_on_card(machine, samples, aperture, options.filter_of_pixels(), shutter)
    return cuda_refine.correct(machine, image, mean, options.correction)


def _image_of(
    machine: Machine,
    samples: DeviceSamples,
    plan: Plan,
    options: TemporalOptions,
    relighting: Relighting | None = None,
) -> Any:
    """Make an image that is not corrected."""
    bands = cuda.reconstruct_bands(machine, samples, plan, relighting)
    smoothing = options.smoothing * plan.rule.along_lens
    return cuda_refine.smooth_bands(machine, bands, plan.band_starts, smoothing)


METHOD = Method(
    name="temporal",
    summary="samples seen from many lens points and times, with visibility resolved at each",
    options=TemporalOptions,
    devices=("cpu", "reference", "cuda"),
    run=_run,
    reads_lights=_reads_lights,
)
"""The paper's method for defocus, motion and soft shadows."""
