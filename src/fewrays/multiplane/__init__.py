"""Multiplane: the layers of 2015, with the visibility of 2011.

The layered paper averages each layer's opacity over the lens *before* it composites (Eq. 34), which loses who
hides whom. The temporal paper resolves that at every location, by searching samples. Here samples become maps
of radiance and opacity at the lens centre, one for every depth (`slabs`, `build`), and the maps are laid
behind one another once for every lens point and time, before these are averaged (`render`).
`reference` is all that in plain NumPy, and `cuda` for GPUs; `engine` chooses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewrays.cuda.samples import DeviceSamples
from fewrays.method import Method, Reconstruction
from fewrays.multiplane import reference
from fewrays.multiplane.build import BuildOptions
from fewrays.multiplane.planes import Multiplane
from fewrays.multiplane.preparation import PREPARATION
from fewrays.multiplane.render import RenderOptions
from fewrays.parallel import Execution
from fewrays.samples import SampleBuffer

__all__ = ["METHOD", "BuildOptions", "Multiplane", "MultiplaneOptions", "RenderOptions"]


@dataclass(frozen=True, kw_only=True)
class MultiplaneOptions(RenderOptions, BuildOptions):
    """Options of ``method="multiplane"``: those of both steps."""

    def __post_init__(self) -> None:
        BuildOptions.__post_init__(self)
        super().__post_init__()


def _run(
    samples: SampleBuffer | DeviceSamples, options: MultiplaneOptions, execution: Execution
) -> Reconstruction:
    if execution.device == "reference":
        assert isinstance(samples, SampleBuffer)
        seen = reference.reconstruct(samples, options, execution)
        return Reconstruction(np.ascontiguousarray(seen[..., :3], np.float32))
    planes = PREPARATION.prepare(samples, options, execution)
    return planes.reconstruct(samples.lens, options, execution)


METHOD = Method(
    name="multiplane",
    summary="maps of radiance and opacity by depth, laid behind one another for every lens point and time",
    options=MultiplaneOptions,
    devices=("cpu", "reference", "cuda"),
    run=_run,
    preparation=PREPARATION,
)
"""Our own method."""
