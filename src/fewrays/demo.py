"""The demo: a real render of 8 samples per pixel, reconstructed by every method and measured.

The samples and their reference ship inside the package, so that the demo needs no renderer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path

from fewrays import __version__
from fewrays.display import Candidate, comparison_sheet, save_picture
from fewrays.io import load, load_image, save_image
from fewrays.method import Image
from fewrays.metrics import Comparison, compare
from fewrays.parallel import Execution
from fewrays.reconstruct import METHODS, run_method
from fewrays.samples import SampleBuffer

__all__ = ["Result", "load_demo", "measure_methods", "results_table", "run_demo"]

SAMPLES, REFERENCE = "demo.npz", "demo_reference.exr"


@dataclass(frozen=True)
class Result:
    """What a method made of the samples: its image ``(H, W, 3)``, its quality and its wall time."""

    method: str
    image: Image
    quality: Comparison
    seconds: float

    def note(self) -> str:
        """Return the quality in one line, for a caption."""
        parts = [f"PSNR {self.quality.psnr_display:.1f} dB"]
        if self.quality.flip is not None:
            parts.append(f"FLIP {self.quality.flip:.3f}")
        return " · ".join(parts)


def load_demo() -> tuple[SampleBuffer, Image]:
    """Return the samples that ship with fewrays and the reference image of the same view."""
    data = resources.files("fewrays") / "data"
    with resources.as_file(data / SAMPLES) as samples, resources.as_file(data / REFERENCE) as reference:
        return load(samples), load_image(reference)


def measure_methods(samples: SampleBuffer, reference: Image, *, threads: int | None = None) -> list[Result]:
    """Reconstruct samples with every method and compare with a reference.

    Parameters
    ----------
    samples : SampleBuffer
        The samples.
    reference : ndarray, (H, W, 3)
        The true image under the Gaussian pixel filter; methods that have the choice use it too.
    threads : int, optional
        Threads to use; all usable cores when omitted.

    Returns
    -------
    list of Result
        One per method, the simplest first.
    """
    results = []
    for method in reversed(METHODS.values()):
        execution = Execution("auto", threads, progress=True)
        start = time.perf_counter()
        choosable = {field.name for field in fields(method.options)} & {"pixel_filter"}
        options = method.options(**dict.fromkeys(choosable, "gaussian"))
        image = run_method(samples, method, options, execution).image
        seconds = time.perf_counter() - start
        results.append(Result(method.name, image, compare(image, reference), seconds))
    return results


def results_table(results: list[Result]) -> str:
    """Return the results as text, one method a line; SSIM and FLIP where they could be measured."""
    columns = {"PSNR": [f"{r.quality.psnr_display:.2f} dB" for r in results]}
    for name in ("ssim", "flip"):
        values = [getattr(r.quality, name) for r in results]
        if None not in values:
            columns[name.upper()] = [f"{value:.4f}" for value in values]
    columns["time"] = [f"{r.seconds:.2f} s" for r in results]
    names = ["method", *(r.method for r in results)]
    width = max(map(len, names))
    cells = zip(*([head, *values] for head, values in columns.items()), strict=True)
    rows = zip(names, cells, strict=True)
    return "\n".join(f"{name:<{width}}" + "".join(f"{cell:>11}" for cell in row) for name, row in rows)


def run_demo(out: Path, *, threads: int | None = None) -> None:
    """Reconstruct the shipped samples, write the sheet and the image, print the table.

    Parameters
    ----------
    out : path
        Directory for ``fewrays-demo.png`` and ``fewrays-demo.exr``; made when it does not exist.
    threads : int, optional
        Threads to use; all usable cores when omitted.

    Raises
    ------
    OSError
        When `out` cannot be written.
    """
    samples, reference = load_demo()
    out.mkdir(parents=True, exist_ok=True)
    print(f"{samples.width} x {samples.height} pixels, {samples.spp} spp, {samples.lens.aperture} aperture")
    results = measure_methods(samples, reference, threads=threads)
    print(results_table(results))
    print("PSNR after clip to [0, 1] and gamma 2.2")

    noisy, clean = results[0], results[-1]
    picture = comparison_sheet(
        [
            Candidate(noisy.image, f"{samples.spp} samples per pixel, averaged", noisy.note()),
            Candidate(clean.image, f"the same samples, {clean.method}", clean.note()),
        ],
        Candidate(reference, "reference", "the same view, from many more samples"),
    )
    sheet_file, image_file = out / "fewrays-demo.png", out / "fewrays-demo.exr"
    save_picture(sheet_file, picture)
    provenance = {"software": f"fewrays {__version__}", "method": clean.method, "samples": SAMPLES}
    save_image(image_file, clean.image, provenance=provenance)
    print(f"wrote {sheet_file} and {image_file}")
