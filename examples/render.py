"""Render the example scenes: sample buffers, and references by brute force.

    python examples/render.py foliage
    python examples/render.py foliage serpent citadel --spp 1 2 4 8 --reference-spp 1024

Needs ``fewrays[mitsuba]``. Everything lands in ``examples/renders/``:

- ``<scene>_<sampling>_<spp>spp.npz``: samples, for every lens sampling and number of samples per pixel;
- ``<scene>_reference_gaussian.exr`` and ``…_box.exr``: references under both
  pixel filters;
- ``<scene>_reference.json``: how these were made, and how noisy they still are.
"""

from __future__ import annotations

import argparse
import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fewrays
from fewrays.baselines.accumulation import Accumulator, PixelFilter
from fewrays.parallel import progress_bar
from fewrays.sources import mitsuba as source

SCENES = ("foliage", "citadel", "serpent")
SIGMA = 1 / 3
BATCH_SPP = 16
PIXEL_FILTERS = {"gaussian": PixelFilter("gaussian", 0.5), "box": PixelFilter("box")}


def main() -> None:
    """Render what the command line asks for."""
    options = parse_options()
    source.activate()
    import mitsuba as mi

    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.scenes:
        scene = mi.load_dict(importlib.import_module(f"scenes.{name}").scene(options.width, options.height))
        for sampling in options.sampling:
            for spp in options.spp:
                path = options.out / f"{name}_{sampling}_{spp}spp.npz"
                fewrays.save(path, render_samples(scene, sampling, spp, options))
                print(path)
        if options.reference_spp:
            render_reference(scene, name, options)


def parse_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(SCENES), help=f"of {', '.join(SCENES)} (all)")
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=360)
    parser.add_argument("--spp", type=int, nargs="*", default=[8], help="samples per pixel (8)")
    parser.add_argument("--sampling", nargs="*", default=["square", "gaussian"], help="lens samplings")
    parser.add_argument("--shading-spp", type=int, default=64, help="light paths per sample (64)")
    parser.add_argument("--reference-spp", type=int, default=1024, help="0 for no reference (1024)")
    parser.add_argument("--reference-shading-spp", type=int, default=1, help="light paths per sample (1)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "renders")
    options = parser.parse_args()
    for name in options.scenes:
        if name not in SCENES:
            parser.error(f"unknown scene {name!r}; choose from {', '.join(SCENES)}")
    return options


def render_samples(scene: Any, sampling: Any, spp: int, options: argparse.Namespace) -> fewrays.SampleBuffer:
    """Render one buffer of the scene for a Gaussian lens."""
    return source.render(
        scene,
        spp=spp,
        aperture="gaussian",
        sampling=sampling,
        sigma=SIGMA,
        shading_spp=options.shading_spp,
        progress=True,
    )


def render_reference(scene: Any, name: str, options: argparse.Namespace) -> None:
    """Save images under both pixel filters, and how noisy they are."""
    accumulators = accumulate_reference(
        scene,
        (options.height, options.width),
        PIXEL_FILTERS,
        spp=options.reference_spp,
        shading_spp=options.reference_shading_spp,
    )
    record: dict[str, Any] = {
        "scene": name,
        "width": options.width,
        "height": options.height,
        "aperture": "gaussian",
        "sigma": SIGMA,
        "spp": options.reference_spp,
        "shading_spp": options.reference_shading_spp,
        "noise_psnr_gamma22_db": {},
    }
    for label, accumulator in accumulators.items():
        path = options.out / f"{name}_reference_{label}.exr"
        fewrays.save_image(path, accumulator.image())
        record["noise_psnr_gamma22_db"][label] = round(accumulator.noise_psnr(), 2)
        print(path, f"noise {accumulator.noise_psnr():.1f} dB")
    (options.out / f"{name}_reference.json").write_text(json.dumps(record, indent=2) + "\n")


def accumulate_reference(
    scene: Any, size: tuple[int, int], filters: Mapping[str, PixelFilter], *, spp: int, shading_spp: int = 1
) -> dict[str, Accumulator]:
    """Accumulate importance-sampled batches of a scene under each of the pixel filters."""
    accumulators = {label: Accumulator(*size, pixel_filter) for label, pixel_filter in filters.items()}
    batches = max(2, -(-spp // BATCH_SPP))
    with progress_bar(batches, "reference", show=True, unit="batch") as bar:
        for number in range(batches):
            samples = source.render(
                scene,
                spp=BATCH_SPP,
                aperture="gaussian",
                sigma=SIGMA,
                seed=1000 + number,
                shading_spp=shading_spp,
            )
            for accumulator in accumulators.values():
                accumulator.add(samples)
            bar.update(1)
    return accumulators


if __name__ == "__main__":
    main()
