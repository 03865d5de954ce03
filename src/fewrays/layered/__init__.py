"""Layered light field reconstruction, after Vaidyanathan, Munkberg, Clarberg and Salvi 2015 and beyond it.

Samples are split into thin depth layers. Each layer keeps a map of radiance and opacity as the lens centre
sees it; a separable blur turns it into what a part of the aperture sees, for any blur radius; the layers
are composited front to back, part by part. `reference` is the method in plain NumPy; `slabs` says what a
layer is, `aperture` what a part is, `plan` what all tiles share. `fewrays.layered_published` is the method
as the paper has it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from fewrays.cuda.device import require_machine
from fewrays.cuda.samples import DeviceSamples
from fewrays.errors import require_option
from fewrays.layered import cuda, kernel, reference
from fewrays.layered.aperture import ApertureParts
from fewrays.layered.plan import Plan
from fewrays.method import Method, Reconstruction
from fewrays.parallel import Execution
from fewrays.samples import SampleBuffer

__all__ = ["METHOD", "LayeredOptions"]


@dataclass(frozen=True, kw_only=True)
class LayeredOptions:
    """Options of ``method="layered"``."""

    sigma_pix: float = 0.5
    """Standard deviation of the Gaussian pixel filter, in pixels."""
    layer_spacing: float = 0.1
    """Thickness of a depth layer: about the share by which slopes differ far from focus, and six times as
    many pixels of slope near focus. Larger is faster and less sharp at occlusions."""
    aperture_parts: int = 7
    """Parts of the aperture whose visibility is resolved apart: 1, 7, 13 or 19. More are slower, and truer
    where blurred things cover each other."""
    tile: int = 128
    """Side of a tile in pixels; a matter of speed."""

    def __post_init__(self) -> None:
        require_option("sigma_pix", self.sigma_pix, 0.0 < self.sigma_pix <= 4.0, "in (0, 4] px")
        require_option(
            "layer_spacing", self.layer_spacing, 0.05 <= self.layer_spacing <= 1.0, "from 0.05 to 1"
        )
        choices = ", ".join(map(str, ApertureParts.COUNTS))
        require_option(
            "aperture_parts",
            self.aperture_parts,
            self.aperture_parts in ApertureParts.COUNTS,
            f"among {choices}",
        )
        require_option("tile", self.tile, 16 <= self.tile <= 256, "from 16 to 256 px")


def _run(
    samples: SampleBuffer | DeviceSamples, options: LayeredOptions, execution: Execution
) -> Reconstruction:
    if execution.device == "cuda":
        return _run_on_card(samples, options, execution)
    assert isinstance(samples, SampleBuffer)
    plan = Plan.for_samples(samples, **asdict(options))
    shape = (samples.height, samples.width)
    image = np.zeros((*shape, 3), np.float32)
    counts = np.zeros(plan.tile_count, np.int32)
    contributions = np.zeros((*shape, plan.slabs.count, 4), np.float32) if execution.aovs else None
    engine = reference if execution.device == "reference" else kernel
    engine.reconstruct_tiles(samples, plan, image, counts, contributions, execution)
    return plan.reconstruction(image, counts, contributions)


def _run_on_card(
    samples: SampleBuffer | DeviceSamples, options: LayeredOptions, execution: Execution
) -> Reconstruction:
    machine = require_machine()
    on_card = DeviceSamples.of_buffer(machine, samples) if isinstance(samples, SampleBuffer) else samples
    image, counts, contributions, plan = cuda.reconstruct_image(
        machine, on_card, options, aovs=execution.aovs
    )
    if contributions is None:
        return Reconstruction(execution.deliver(machine, image))
    host = machine.on_host
    return plan.reconstruction(execution.deliver(machine, image), host(counts), host(contributions))


METHOD = Method(
    name="layered",
    summary="thin depth layers, blurred and composited by parts of the aperture",
    options=LayeredOptions,
    devices=("cpu", "reference", "cuda"),
    run=_run,
)
