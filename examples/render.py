"""Render the example scenes: sample buffers, and references by brute force.

    python examples/render.py foliage
    python examples/render.py foliage serpent citadel --spp 1 2 4 8 --reference-spp 1024
    python examples/render.py butterflies --aperture disc --spp 1 2 4 8 16
    python examples/render.py excavator --spp 4 --reference-spp 1024
    python examples/render.py excavator --variants light --width 320 --height 180 --spp 4

Needs ``fewrays[mitsuba]``. Everything lands in ``examples/renders/``:

- ``<scene>_<sampling>_<spp>spp.npz``: samples, for every lens sampling and number of samples per pixel;
- ``<scene>_reference_gaussian.exr`` and ``…_box.exr``: references under both pixel filters for the Gaussian
  lens; ``<scene>_disc_reference_…`` for the disc;
- ``<scene>_reference.json``, ``<scene>_disc_reference.json``: how these were made, and how noisy they still
  are.

Samples and references of scenes with motion cover the whole shutter interval.

The excavator has variants, always a disc for a lens, and light samples: ``excavator_<variant>_<spp>spp.npz``
and ``excavator_<variant>_reference_box.exr``. Its variant ``light`` is a sequence, ``excavator_light_<k>_…``,
over which the lamp moves sideways; each frame has a seed of its own.
"""

from __future__ import annotations

import argparse
import importlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fewrays
from fewrays.baselines.accumulation import Accumulator
from fewrays.lens import LensAperture
from fewrays.parallel import progress_bar
from fewrays.pixel_filter import PixelFilter
from fewrays.sources import mitsuba as source

STILL_SCENES = ("foliage", "citadel", "serpent")
LIT_SCENES = ("excavator",)
SCENES = (*STILL_SCENES, "butterflies", *LIT_SCENES)
SAMPLINGS: dict[LensAperture, tuple[str, ...]] = {"gaussian": ("square", "gaussian"), "disc": ("disc",)}
"""How the lens is sampled for each aperture."""

SIGMA = 1 / 3
BATCH_SPP = 16
MOVING_BATCH_SPP = 128  # of moving scenes: each batch poses the scene once for every slice of time
PIXEL_FILTERS = {"gaussian": PixelFilter("gaussian", 0.5), "box": PixelFilter("box")}


@dataclass(frozen=True)
class Take:
    """One thing to render: a loaded scene, what moves in it, and what its files are called.

    ``stem`` begins the names of files with samples, followed by the lens's sampling unless ``lighting``;
    ``settings`` go to `fewrays.sources.mitsuba.render`.
    """

    stem: str
    scene: Any
    motion: Mapping[str, Any] | None
    lighting: bool = False
    seed: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)


def main() -> None:
    """Render what the command line asks for."""
    options = parse_options()
    source.activate()
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.scenes:
        for take in lit_takes(name, options) if name in LIT_SCENES else takes(name, options):
            for sampling in ("disc",) if take.lighting else options.sampling:
                for spp in options.spp:
                    stem = take.stem if take.lighting else f"{take.stem}_{sampling}"
                    path = options.out / f"{stem}_{spp}spp.npz"
                    fewrays.save(path, render_samples(take, sampling, spp, options))
                    print(path, flush=True)
            if options.reference_spp:
                render_reference(take, options)


def takes(name: str, options: argparse.Namespace) -> Iterator[Take]:
    """Load a scene that has no variants."""
    import mitsuba as mi

    module = importlib.import_module(f"scenes.{name}")
    moves = hasattr(module, "motion")
    scene = mi.load_dict(module.scene(options.width, options.height), optimize=not moves)
    yield Take(name, scene, module.motion() if moves else None)


def lit_takes(name: str, options: argparse.Namespace) -> Iterator[Take]:
    """Load each variant of a scene whose lights are sampled apart, and each frame of the moving light."""
    import mitsuba as mi

    module = importlib.import_module(f"scenes.{name}")
    unknown = set(options.variants or ()) - {*module.VARIANTS, "light"}
    if unknown:
        raise SystemExit(f"{name} has no variants {sorted(unknown)}; it has {[*module.VARIANTS, 'light']}")
    for variant, (lens_radius, moves) in module.VARIANTS.items():
        if options.variants is None or variant in options.variants:
            scene = mi.load_dict(module.scene(options.width, options.height), optimize=False)
            motion = module.motion() if moves else None
            lens = {"lens_radius": lens_radius, "focus_distance": module.FOCUS}
            yield Take(f"{name}_{variant}", scene, motion, lighting=True, settings=lens)
    if options.variants is not None and "light" in options.variants:
        for frame, shift in enumerate(module.LIGHT_SHIFTS):
            content = module.scene(options.width, options.height, light_shift=shift)
            pinhole = {"lens_radius": 0.0, "focus_distance": module.FOCUS}
            yield Take(
                f"{name}_light_{frame}", mi.load_dict(content), None, True, seed=frame, settings=pinhole
            )


def parse_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "scenes", nargs="*", default=list(STILL_SCENES), help=f"of {', '.join(SCENES)} (all that are still)"
    )
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=360)
    parser.add_argument("--spp", type=int, nargs="*", default=[8], help="samples per pixel (8)")
    parser.add_argument("--variants", nargs="*", help="of scenes that have some (all but light)")
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


def render_samples(take: Take, sampling: Any, spp: int, options: argparse.Namespace) -> fewrays.SampleBuffer:
    """Render one buffer of a scene."""
    return source.render(
        take.scene,
        spp=spp,
        aperture="disc" if take.lighting else options.aperture,
        sampling=sampling,
        sigma=SIGMA,
        seed=take.seed,
        shading_spp=options.shading_spp,
        motion=take.motion,
        lighting=take.lighting,
        progress=True,
        **take.settings,
    )


def render_reference(take: Take, options: argparse.Namespace) -> None:
    """Save images under the pixel filters, and how noisy they are."""
    aperture: LensAperture = "disc" if take.lighting else options.aperture
    accumulators = accumulate_reference(
        take.scene,
        (options.height, options.width),
        {"box": PIXEL_FILTERS["box"]} if take.lighting else PIXEL_FILTERS,
        spp=options.reference_spp,
        shading_spp=options.reference_shading_spp,
        aperture=aperture,
        motion=take.motion,
        **take.settings,
    )
    record: dict[str, Any] = {
        "scene": take.stem,
        "width": options.width,
        "height": options.height,
        "aperture": aperture,
        **({"sigma": SIGMA} if aperture == "gaussian" else {}),
        "spp": options.reference_spp,
        "shading_spp": options.reference_shading_spp,
        "noise_psnr_gamma22_db": {},
    }
    plain = take.lighting or aperture == "gaussian"
    stem = f"{take.stem}_reference" if plain else f"{take.stem}_{aperture}_reference"
    for label, accumulator in accumulators.items():
        path = options.out / f"{stem}_{label}.exr"
        fewrays.save_image(path, accumulator.image())
        record["noise_psnr_gamma22_db"][label] = round(accumulator.noise_psnr(), 2)
        print(path, f"noise {accumulator.noise_psnr():.1f} dB", flush=True)
    (options.out / f"{stem}.json").write_text(json.dumps(record, indent=2) + "\n")


def accumulate_reference(
    scene: Any,
    size: tuple[int, int],
    filters: Mapping[str, PixelFilter],
    *,
    spp: int,
    shading_spp: int = 1,
    aperture: LensAperture = "gaussian",
    motion: Mapping[str, Any] | None = None,
    **settings: Any,
) -> dict[str, Accumulator]:
    """Accumulate importance-sampled batches of a scene under each of the pixel filters.

    `settings` are further ones of `fewrays.sources.mitsuba.render`.
    """
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
                **settings,
            )
            for accumulator in accumulators.values():
                accumulator.add(samples)
            bar.update(1)
    return accumulators


if __name__ == "__main__":
    main()
