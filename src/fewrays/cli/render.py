"""``fewrays render``: samples from a Mitsuba 3 scene."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg

from fewrays.cli.command import SAMPLE_SUFFIXES, Command, check_output, report, stopwatch
from fewrays.io import save
from fewrays.lens import LensAperture, Sampling

__all__ = ["Render"]


@dataclass(frozen=True)
class Render(Command):
    """Render samples of a Mitsuba 3 scene.

    The scene needs a 'thinlens' sensor, or a 'perspective' one together with --lens-radius and
    --focus-distance. Needs the 'mitsuba' extra and, without a CUDA GPU, LLVM 17 or later.

    Parameters
    ----------
    scene
        The scene, as Mitsuba's XML.
    out
        The file of samples to write.
    spp
        Primary samples per pixel, each with a position on the image and on the lens.
    width, height
        Image size in pixels; the film's unless given. One alone keeps the film's aspect ratio.
    aperture
        What the image is to integrate over.
    sampling
        How lens positions are drawn; as the aperture unless given.
    sigma
        Standard deviation of Gaussian aperture and sampling, in lens radii.
    lens_radius
        In scene units; the 'thinlens' sensor's own unless given.
    focus_distance
        Depth of the focal plane in scene units; the 'thinlens' sensor's own unless given.
    shading_spp
        Light paths averaged into each sample: raise it where the light is hard to sample.
    bandwidth
        Store how far over the lens each radiance holds: for glossy surfaces, and the method 'temporal'.
    lighting
        Trace a ray from every rectangle and disc light to every sample: for soft shadows, and the method
        'temporal'.
    max_depth
        Longest light path, in bounces plus one; replaces the scene's integrator by a path tracer.
    background_depth
        Depth of rays that leave the scene; far beyond everything in it unless given.
    sensor
        Which of the scene's sensors to use, from 0.
    seed
        Another seed gives independent samples.
    variant
        Mitsuba's back end; CUDA where there is a GPU, else LLVM, unless given.
    """

    examples: ClassVar[tuple[str, ...]] = (
        "fewrays render scene.xml --out samples.npz --spp 8",
        "fewrays render scene.xml --out samples.npz --width 640 --lens-radius 0.05 --focus-distance 3.5",
        "fewrays render scene.xml --out samples.npz --aperture gaussian --sampling square",
    )

    scene: Annotated[Positional[Path], arg(metavar="SCENE.xml")]
    out: Path
    spp: int = 8
    width: int | None = None
    height: int | None = None
    aperture: LensAperture = "disc"
    sampling: Sampling | None = None
    sigma: float = 1.0 / 3.0
    lens_radius: float | None = None
    focus_distance: float | None = None
    shading_spp: int = 16
    bandwidth: bool = False
    lighting: bool = False
    max_depth: int | None = None
    background_depth: float | None = None
    sensor: int = 0
    seed: int = 0
    variant: Literal["llvm_ad_rgb", "cuda_ad_rgb"] | None = None

    def run(self) -> None:
        """Trace the samples and save them."""
        from fewrays.sources.mitsuba import render

        check_output(self.out, SAMPLE_SUFFIXES)
        settings: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "out"}
        with stopwatch() as watch:
            samples = render(settings.pop("scene"), progress=True, **settings)
        save(self.out, samples)
        report("render", samples, watch, self.out)
