"""Make the small sample buffer and reference that ship inside the package, for ``fewrays demo``.

    python examples/make_demo.py

Needs ``fewrays[mitsuba]``. Renders the foliage scene at 320 x 180 and 8 samples per pixel, drops digits that
no reconstruction can see, so that the file compresses, and accumulates a reference.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

import fewrays
from fewrays.arrays import Float32
from fewrays.sources import mitsuba as source
from render import PIXEL_FILTERS, SIGMA, accumulate_reference
from scenes import foliage

DATA = Path(__file__).parents[1] / "src" / "fewrays" / "data"
WIDTH, HEIGHT, SPP = 320, 180, 8
SHADING_SPP = 64
REFERENCE_SPP = 2048


def main() -> None:
    """Render and write both files."""
    source.activate()
    import mitsuba as mi

    scene = mi.load_dict(foliage.scene(WIDTH, HEIGHT))
    samples = source.render(
        scene,
        spp=SPP,
        aperture="gaussian",
        sampling="square",
        sigma=SIGMA,
        shading_spp=SHADING_SPP,
        progress=True,
    )
    DATA.mkdir(exist_ok=True)
    fewrays.save(DATA / "demo.npz", rounded(samples), compressed=True, half=True)

    filters = {"gaussian": PIXEL_FILTERS["gaussian"]}
    accumulator = accumulate_reference(scene, (HEIGHT, WIDTH), filters, spp=REFERENCE_SPP)["gaussian"]
    provenance = {
        "scene": "foliage",
        "spp": str(REFERENCE_SPP),
        "noise": f"{accumulator.noise_psnr():.1f} dB PSNR after gamma 2.2",
    }
    image = accumulator.image().astype(np.float16).astype(np.float32)
    fewrays.save_image(DATA / "demo_reference.exr", image, provenance=provenance)
    print(f"reference noise {accumulator.noise_psnr():.1f} dB")
    for file in sorted(DATA.iterdir()):
        print(f"{file.name}: {file.stat().st_size / 2**20:.2f} MiB")


def rounded(samples: fewrays.SampleBuffer) -> fewrays.SampleBuffer:
    """Round positions to 1/1024 px and 1/2048 of the lens, and depth and radiance to 12 bits."""
    return fewrays.SampleBuffer(
        xy=np.floor(samples.xy * 1024) / 1024,
        uv=np.round(samples.uv * 2048) / 2048,
        depth=_to_bits(samples.depth, 12),
        color=_to_bits(samples.color, 11),
        lens=samples.lens,
    )


def _to_bits(values: Float32, bits: int) -> npt.NDArray[np.float64]:
    mantissa, exponent = np.frexp(values.astype(np.float64))
    return np.asarray(np.ldexp(np.round(mantissa * 2**bits) / 2**bits, exponent))


if __name__ == "__main__":
    main()
