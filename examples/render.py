"""Render the example scenes: sample buffers, and references by brute force.

    python examples/render.py foliage
    python examples/render.py foliage serpent citadel --spp 1 2 4 8 --reference-spp 1024
    python examples/render.py butterflies --aperture disc --spp 1 2 4 8 16

Needs ``fewrays[mitsuba]``. Everything lands in ``examples/renders/``:

- ``<scene>_<sampling>_<spp>spp.npz``: samples, for every lens sampling and number of samples per pixel;
- ``<scene>_reference_gaussian.exr`` and ``…_box.exr``: references under both pixel filters for the Gaussian
  lens; ``<scene>_disc_reference_…`` for the disc;
- ``<scene>_reference.json``, ``<scene>_disc_reference.json``: how these were made, and how noisy they still
  are.

Samples and references of scenes with motion cover the whole shutter interval.
"""

from __future__ import annotations

import argparse
import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fewrays
from fewrays.baselines.accumulation import Accumulator
from fewrays.lens import Aperture
from fewrays.parallel import progress_bar
from fewrays.pixel_filter import PixelFilter
from fewrays.sources import mitsuba as source

STILL_SCENES = ("foliage", "citadel", "serpent")
SCENES = (*STILL_SCENES, "butterflies")
SAMPLINGS: dict[Aperture, tuple[str, ...]] = {"gaussian": ("square", "gaussian"), "disc": ("disc",)}
"""How the lens is sampled for each aperture."""

SIGMA = 1 / 3
BATCH_SPP = 16
MOVING_BATCH_SPP = 128  # of moving scenes: each batch poses the scene once for every slice of time
PIXEL_FILTERS = {"gaussian": PixelFilter("gaussian", 0.5), "box": PixelFilter("box")}


def main() -> None:
    """Render what the command line asks for."""
    options = parse_options()
    source.activate()
    import mitsuba as mi

    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.scenes:
        module = importlib.import_module(f"scenes.{name}")
        scene = mi.load_dict(
            module.scene(options.width, options.height), optimize=not hasattr(module, "motion")
        )
        motion = module.motion() if hasattr(module, "motion") else None
        for sampling in options.sampling:
            for spp in options.spp:
                path = options.out / f"{name}_{sampling}_{spp}spp.npz"
                fewrays.save(path, render_samples(scene, motion, sampling, spp, options))
                print(path)
        if options.reference_spp:
            render_reference(scene, motion, name, options)


def parse_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "scenes", nargs="*", default=list(STILL_SCENES), help=f"of {', '.join(SCENES)} (all that are still)"
    )
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=360)
    parser.add_argument("--spp", type=int, nargs="*", default=[8], help="samples per pixel (8)")
    parser.add_argument("--aperture", choices=list(SAMPLINGS), default="gaussian", help="lens (gaussian)")
    parser.add_argument("--sampling", nargs="*", help="lens samplings (all that go with the aperture)")
    parser.add_argument("--shading-spp", type=int, default=64, help="light paths per sample (64)")
    parser.add_argument("--reference-spp", type=int, default=1024, help="0 for no reference (1024)")
    parser.add_argument("--reference-shading-spp", type=int, default=1, help="light paths per sample (1)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "renders")
    options = parser.parse_args()
    for name in options.scenes:
        if name not in SCENES:
            parser.error(f"unknown scene {name!r}; choose from {', '.join(SCENES)}")
    allowed = SAMPLINGS[options.aperture]
    options.sampling = list(allowed) if options.sampling is None else options.sampling
    for sampling in options.sampling:
        if sampling not in allowed:
            parser.error(f"the {options.aperture} takes samplings of {', '.join(allowed)}; got {sampling!r}")
    return options


def render_samples(
    scene: Any, motion: Mapping[str, Any] | None, sampling: Any, spp: int, options: argparse.Namespace
) -> fewrays.SampleBuffer:
    """Render one buffer of the scene."""
    return source.render(
        scene,
        spp=spp,
        aperture=options.aperture,
        sampling=sampling,
        sigma=SIGMA,
        shading_spp=options.shading_spp,
        motion=motion,
        progress=True,
    )


def render_reference(
    scene: Any, motion: Mapping[str, Any] | None, name: str, options: argparse.Namespace
) -> None:
    """Save images under both pixel filters, and how noisy they are."""
    accumulators = accumulate_reference(
        scene,
        (options.height, options.width),
        PIXEL_FILTERS,
        spp=options.reference_spp,
        shading_spp=options.reference_shading_spp,
        aperture=options.aperture,
        motion=motion,
    )
    record: dict[str, Any] = {
        "scene": name,
        "width": options.width,
        "height": options.height,
        "aperture": options.aperture,
        **({"sigma": SIGMA} if options.aperture == "gaussian" else {}),
        "spp": options.reference_spp,
        "shading_spp": options.reference_shading_spp,
        "noise_psnr_gamma22_db": {},
    }
    stem = f"{name}_reference" if options.aperture == "gaussian" else f"{name}_{options.aperture}_reference"
    for label, accumulator in accumulators.items():
        path = options.out / f"{stem}_{label}.exr"
        fewrays.save_image(path, accumulator.image())
        record["noise_psnr_gamma22_db"][label] = round(accumulator.noise_psnr(), 2)
        print(path, f"noise {accumulator.noise_psnr():.1f} dB")
    (options.out / f"{stem}.json").write_text(json.dumps(record, indent=2) + "\n")


def accumulate_reference(
    scene: Any,
    size: tuple[int, int],
    filters: Mapping[str, PixelFilter],
    *,
    spp: int,
    shading_spp: int = 1,
    aperture: Aperture = "gaussian",
    motion: Mapping[str, Any] | None = None,
) -> dict[str, Accumulator]:
    """Accumulate importance-sampled batches of a scene under each of the pixel filters."""
    accumulators = {label: Accumulator(*size, pixel_filter) for label, pixel_filter in filters.items()}
    batch_spp = min(MOVING_BATCH_SPP, max(1, spp // 2)) if motion else BATCH_SPP
    batches = max(2, -(-spp // batch_spp))
    with progress_bar(batches, "reference", show=True, unit="batch") as bar:
        for number in range(batches):
            samples = source.render(
                scene,
                spp=batch_spp,
                aperture=aperture,
                sigma=SIGMA,
                seed=1000 + number,
                shading_spp=shading_spp,
                motion=motion,
            )
            for accumulator in accumulators.values():
                accumulator.add(samples)
            bar.update(1)
    return accumulators


if __name__ == "__main__":
    main()
