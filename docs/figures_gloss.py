"""Picture and numbers of glossy highlights out of focus, in `mitsuba.md`.

Renders ``examples/scenes/gloss.py`` and needs ``fewrays[mitsuba]``; some minutes::

    python docs/figures_gloss.py

After *temporal*, section 6, Figure 14: the samples' average, reconstructions without and with the samples'
bandwidth, and a reference; all of 16 samples per pixel. PSNR after clip to [0, 1] and gamma 2.2, over the
pixels that show nothing but metal.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro

from fewrays import SampleBuffer, reconstruct
from fewrays.display import Panel, tone_map
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.pixel_filter import PixelFilter
from figure_drawing import write
from figure_measures import print_table

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))

_SPP, _SHADING_SPP = 16, 36
_REFERENCE_SHADING_SPP = 4


def render(width: int, height: int, reference_spp: int) -> tuple[SampleBuffer, Image]:
    """Render the scene's samples, with bandwidths, and a reference under the box filter."""
    from fewrays.sources import mitsuba as source

    source.activate()
    import mitsuba as mi

    from render import accumulate_reference

    scene = mi.load_dict(importlib.import_module("scenes.gloss").scene(width, height))
    samples = source.render(scene, spp=_SPP, shading_spp=_SHADING_SPP, bandwidth=True)
    accumulator = accumulate_reference(
        scene,
        (height, width),
        {"box": PixelFilter("box")},
        spp=reference_spp,
        shading_spp=_REFERENCE_SHADING_SPP,
        aperture="disc",
    )["box"]
    print(f"reference: {reference_spp} spp, its noise is at {accumulator.noise_psnr():.1f} dB")
    return samples, accumulator.image()


def reconstructions(samples: SampleBuffer) -> dict[str, Image]:
    """Return what is compared, by name; the paper has no correction by the samples' own mean."""
    matte = replace(samples, bandwidth=None)
    return {
        "average of the samples": reconstruct(samples, "box"),
        "without bandwidth, no correction": reconstruct(matte, "temporal", correction=0.0),
        "with bandwidth, no correction": reconstruct(samples, "temporal", correction=0.0),
        "without bandwidth": reconstruct(matte, "temporal"),
        "with bandwidth": reconstruct(samples, "temporal"),
    }


def main(width: int = 400, height: int = 300, reference_spp: int = 512) -> None:
    """Print the table and write ``images/temporal-gloss.png``."""
    samples, truth = render(width, height, reference_spp)
    assert samples.bandwidth is not None
    metal = np.asarray(np.isfinite(samples.bandwidth).all(axis=-1))
    print(f"bandwidth of the metal: median {np.median(samples.bandwidth[metal]):.2f} lens radii")
    low, high = np.percentile(np.abs(np.asarray(samples.lens.slope(samples.depth[metal]))), [5, 95])
    print(f"circles of confusion of the metal: {low:.0f} to {high:.0f} px for nine in ten samples")
    rows, panels = [], []
    for name, image in reconstructions(samples).items():
        decibels = f"{psnr_display(image[metal][None], truth[metal][None]):.2f}"
        rows.append([name, decibels])
        panels.append(Panel(tone_map(image), name, f"{decibels} dB"))
    print_table("gloss: PSNR on the metal in dB", ("image", "PSNR"), rows)
    panels.append(Panel(tone_map(truth), "reference", f"{reference_spp} samples per pixel"))
    write("temporal-gloss", [panels[:3], panels[3:]])


if __name__ == "__main__":
    tyro.cli(main)
