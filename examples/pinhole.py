"""Render the example scenes through pinholes, with depth: the input of ``fewrays defocus``.

    python examples/pinhole.py
    python examples/pinhole.py --views 12 24 36 48 64
    python examples/pinhole.py foliage --spp 256 --width 1280 --height 720

Needs ``fewrays[mitsuba]``. Everything lands in ``examples/renders/``:

- ``<scene>_pinhole.exr``: colour, antialiased, and planar depth of the pixels' centres; the coefficients of
  the scene's own lens are in the header, so that ``fewrays defocus`` needs no other numbers;
- ``<scene>_pinhole_behind.exr``: the same of what lies behind that, for ``--behind``;
- ``<scene>_accumulated_<N>.exr``: the mean of N pinhole renders from points of the lens, which are the first
  of a Halton sequence: the accumulation buffer, with which defocus is compared.
"""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
from typing import Any

import numpy as np

import fewrays
from fewrays.aperture import Aperture
from fewrays.dynamic.views import halton_points
from fewrays.io.rgbz import save_rgbz
from fewrays.parallel import progress_bar
from fewrays.sources import mitsuba as source
from fewrays.sources.mitsuba_views import PinholeViews
from render import STILL_SCENES


def main() -> None:
    """Render what the command line asks for."""
    options = parse_options()
    source.activate()
    import mitsuba as mi

    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.scenes:
        scene = mi.load_dict(importlib.import_module(f"scenes.{name}").scene(options.width, options.height))
        views = PinholeViews(scene, spp=options.spp, progress=True)
        for layer, suffix in zip(views.layers(), ("", "_behind"), strict=True):
            path = options.out / f"{name}_pinhole{suffix}.exr"
            save_rgbz(path, layer, lens=(views.lens.c0, views.lens.c1))
            print(path, flush=True)
        if options.views:
            accumulate_views(scene, name, options)


def accumulate_views(scene: Any, name: str, options: argparse.Namespace) -> None:
    """Save the means of the first pinhole renders for every number of views."""
    views = PinholeViews(scene, spp=options.view_spp)
    points = halton_points(Aperture.of_lens(views.lens), max(options.views))
    total = np.zeros((options.height, options.width, 3))
    with progress_bar(len(points), name, show=True, unit="view") as bar:
        for count, (u, v) in enumerate(points.tolist(), 1):
            total += views.view((u, v), seed=count)
            bar.update()
            if count in options.views:
                path = options.out / f"{name}_accumulated_{count}.exr"
                fewrays.save_image(path, total / count)
                print(path, flush=True)


def parse_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "scenes", nargs="*", default=list(STILL_SCENES), help=f"of {', '.join(STILL_SCENES)} (all)"
    )
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=360)
    parser.add_argument("--spp", type=int, default=64, help="light paths per pixel and layer (64)")
    parser.add_argument("--views", type=int, nargs="*", default=[], help="numbers of views to accumulate")
    parser.add_argument("--view-spp", type=int, default=8, help="light paths per pixel and view (8)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "renders")
    options = parser.parse_args()
    for name in options.scenes:
        if name not in STILL_SCENES:
            parser.error(f"unknown scene {name!r}; choose from {', '.join(STILL_SCENES)}")
    return options


if __name__ == "__main__":
    main()
