"""``fewrays refocus``: a rack-focus sequence from one file of samples.

The samples stay as they are; every frame looks at them through a lens that is focused elsewhere (temporal,
section 6 and Figure 13). What a method can do before it knows the lens, it does once for all frames.

Frames are spaced evenly in dioptres, 1 / distance. The slope of a surface at depth z through a lens focused
at f is ``C = c0 (1/z - 1/f)``: equal steps of 1/f change every circle of confusion by equal numbers of
pixels. Equal steps of f would race through the near distances, crawl through the far ones, and never reach
infinity, which is 0 dioptres.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Generic, Literal, TypeVar

import numpy as np
import numpy.typing as npt
import PIL.features
import PIL.Image
from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from fewrays.cli.command import (
    IMAGE_SUFFIXES,
    Command,
    InputFlags,
    SamplesFile,
    check_output,
    stopwatch,
)
from fewrays.cli.methods import DEFAULT_METHOD, provenance
from fewrays.cli.source import Source, open_source
from fewrays.display import tone_map
from fewrays.errors import SampleError, require_option
from fewrays.io import save_image
from fewrays.io.files import replace_files
from fewrays.method import Image
from fewrays.parallel import Execution, progress_bar
from fewrays.reconstruct import METHODS, find_method
from fewrays.samples import SampleBuffer

__all__ = ["Ease", "Refocus", "depth_at", "focus_distances", "frame_path"]

Options = TypeVar("Options")
Ease = Literal["none", "in", "out", "in-out"]

_ANIMATION_SUFFIXES = (".gif", ".webp")
_NUMBER = re.compile(r"%0?(\d*)d|\{\}")  # where a file name takes the frame's number
_DIGITS = 4
_EASINGS: dict[Ease, Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]] = {
    "none": lambda t: t,
    "in": np.square,
    "out": lambda t: t * (2 - t),
    "in-out": lambda t: t * t * (3 - 2 * t),
}


@dataclass(frozen=True)
class Refocus(Command, Generic[Options]):
    """Reconstruct a sequence of images whose focus travels from one distance to another.

    Each end is a distance or a pixel that shall be sharp; an end that is not given is the lens's own focus.
    Each method has its own options: 'fewrays refocus --method NAME --help' shows them.

    Parameters
    ----------
    samples
        The samples: .npz, version 1.3 (.tlfr, .bin, .txt), or deep .exr. Or the .planes of 'fewrays planes'.
    out
        Images (.png, .exr, .npy): frame.png gives frame.0001.png and so on; %03d or {} in the name stands for
        the frame's number. Or one animation (.gif, .webp).
    from_
        Depth of the focal plane in the first frame, in scene units; 'inf' allowed.
    to
        Depth of the focal plane in the last frame.
    focus_at
        Column and row of a pixel: focus on the nearest surface there. Given twice it says both ends, given
        once the end that --from or --to does not. Needs samples.
    frames
        Number of images, at least 2; evenly spaced in 1 / distance.
    ease
        Start slowly ('in'), end slowly ('out'), or both.
    fps
        Frames per second of an animation; a .gif rounds their length to hundredths of a second.
    method
        How to reconstruct.
    device
        'auto' is the method's fastest; 'reference' runs its plain NumPy definition, slowly.
    threads
        Threads to use; all usable cores when omitted. The result does not depend on it.
    exposure
        Brightening of .png, .gif and .webp, in stops.
    """

    examples: ClassVar[tuple[str, ...]] = (
        "fewrays refocus samples.npz --from 2 --to 5 --frames 24 --out frame.png",
        "fewrays refocus samples.npz --focus-at 60 180 --focus-at 400 90 --ease in-out --out rack.gif",
        "fewrays refocus samples.npz --to inf --aperture-scale 2 --method axis-aligned --out rack.%03d.exr",
    )

    samples: SamplesFile
    out: Path
    from_: Annotated[float | None, arg(name="from")] = None
    to: float | None = None
    focus_at: Annotated[UseAppendAction[tuple[tuple[int, int], ...]], arg(metavar="X Y")] = ()
    frames: int = 24
    ease: Ease = "none"
    fps: float = 24.0
    method: Annotated[str, arg(metavar="{" + ",".join(METHODS) + "}")] = DEFAULT_METHOD
    device: Literal["auto", "cpu", "reference"] = "auto"
    threads: int | None = None
    exposure: float = 0.0
    input: OmitArgPrefixes[InputFlags] = field(default_factory=InputFlags)
    options: Annotated[OmitArgPrefixes[Options], arg(name="method")] = field(kw_only=True)

    def run(self) -> None:
        """Load, then reconstruct and save frame by frame."""
        self._check()
        source = open_source(self.samples, find_method(self.method), self.input)
        if source.lens.c0 == 0:
            raise SampleError("is a pinhole, for which everything is in focus", field="lens")
        distances = focus_distances(*self._ends(source), self.frames, self.ease)
        with stopwatch() as watch:
            if self.out.suffix.lower() in _ANIMATION_SUFFIXES:
                pictures = [tone_map(image, self.exposure) for image, _ in self._images(source, distances)]
                save_animation(self.out, pictures, self.fps)
                written = str(self.out)
            else:
                paths = [frame_path(self.out, number) for number in range(1, self.frames + 1)]
                for path, (image, notes) in zip(paths, self._images(source, distances), strict=True):
                    save_image(path, image, exposure=self.exposure, provenance=notes)
                written = f"{paths[0]} ... {paths[-1].name}"
        print(
            f"{self.method}: {self.frames} frames focused at {distances[0]:.6g} to {distances[-1]:.6g}, "
            f"{source.size}, {watch.seconds:.2f} s -> {written}"
        )

    def _check(self) -> None:
        """Refuse what cannot work before the samples are loaded."""
        check_output(self.out, (*IMAGE_SUFFIXES, *_ANIMATION_SUFFIXES))
        suffix = self.out.suffix.lower()
        if suffix == ".webp" and not PIL.features.check("webp"):
            raise SampleError("this build of Pillow cannot write WebP; use .gif", file=self.out)
        if self.exposure and suffix not in (".png", *_ANIMATION_SUFFIXES):
            raise SampleError(
                "is for .png, .gif and .webp; others store the radiance itself", field="exposure"
            )
        require_option("frames", self.frames, self.frames >= 2, "of at least 2")
        require_option("fps", self.fps, 0 < self.fps <= 100, "above 0 and up to 100")
        given = [name for name, end in (("--from", self.from_), ("--to", self.to)) if end is not None]
        if not given and not self.focus_at:
            raise SampleError("say where the focus goes: --to, --from or --focus-at", field="to")
        if len(given) + len(self.focus_at) > 2:
            raise SampleError(
                f"a sequence has two ends; got {', '.join([*given, *['--focus-at'] * len(self.focus_at)])}",
                field="focus_at",
            )

    def _ends(self, source: Source) -> tuple[float, float]:
        """Return the focus distances of the first and the last frame."""
        own = source.lens.focus_distance
        if self.focus_at and source.samples is None:
            raise SampleError(
                "needs samples to find a depth; give distances with --from and --to",
                file=self.samples,
                field="focus_at",
            )
        seen = [depth_at(source.samples, *pixel) for pixel in self.focus_at if source.samples is not None]
        first, last = self.from_, self.to
        if len(seen) == 2:
            first, last = seen
        elif seen and last is None:
            last = seen[0]
        elif seen:
            first = seen[0]
        return (own if first is None else first, own if last is None else last)

    def _images(self, source: Source, distances: Sequence[float]) -> Iterator[tuple[Image, dict[str, str]]]:
        """Yield each frame's image and how it was made."""
        method = find_method(self.method)
        lenses = [source.lens.refocus(distance) for distance in distances]
        with progress_bar(len(lenses), "refocus", show=True, unit="frame") as bar:
            render = source.renderer(self.options, Execution(self.device, self.threads))
            for lens in lenses:
                yield render(lens).image, provenance(method, self.options, lens, self.samples)
                bar.update()


def focus_distances(first: float, last: float, frames: int, ease: Ease = "none") -> list[float]:
    """Return the focus distance of every frame, evenly spaced in dioptres before easing.

    Parameters
    ----------
    first, last : float
        Distances of the ends in scene units, positive; infinity is 0 dioptres.
    frames : int
        How many, at least 2.
    ease : {"none", "in", "out", "in-out"}
        Where the focus travels slowly: nowhere, at the start, at the end, or at both.

    Raises
    ------
    SampleError
        For a distance that is not positive.
    """
    for name, distance in (("from", first), ("to", last)):
        require_option(name, distance, distance > 0, "above 0, as a focus distance is")
    share = _EASINGS[ease](np.linspace(0, 1, frames))
    dioptres = (1 - share) / first + share / last
    inner = [1 / d if d > 0 else math.inf for d in dioptres[1:-1].tolist()]
    return [first, *inner, last]


def depth_at(samples: SampleBuffer, column: int, row: int) -> float:
    """Return the depth of the nearest surface that the lens centre sees in a pixel, in scene units.

    Each sample is looked for where the lens centre sees its surface, which is where it will be once it is in
    focus, and not where a blurred image spreads it. Where no sample lies in the pixel those closest to it
    count.

    Parameters
    ----------
    samples : SampleBuffer
        The samples; moving ones are taken where and when they were traced.
    column, row : int
        The pixel.

    Raises
    ------
    SampleError
        For a pixel outside the image.
    """
    if not (0 <= column < samples.width and 0 <= row < samples.height):
        raise SampleError(
            f"pixel ({column}, {row}) lies outside the image of {samples.width} x {samples.height}",
            field="focus_at",
        )
    centre = samples.xy - samples.slope()[..., None] * samples.uv
    distance = np.abs(centre - np.array([column + 0.5, row + 0.5], np.float32)).max(axis=-1)
    return float(samples.depth[distance <= max(0.5, float(distance.min()))].min())


def frame_path(pattern: Path, number: int) -> Path:
    """Return the file of a frame: its number in place of ``%04d`` or ``{}``, else before the extension."""
    match = _NUMBER.search(pattern.name)
    if match is None:
        return pattern.with_name(f"{pattern.stem}.{number:0{_DIGITS}}{pattern.suffix}")
    width = _DIGITS if match[0] == "{}" else int(match[1] or 0)
    return pattern.with_name(f"{pattern.name[: match.start()]}{number:0{width}}{pattern.name[match.end() :]}")


def save_animation(path: Path, pictures: Sequence[npt.NDArray[np.uint8]], fps: float) -> None:
    """Write pictures ``(H, W, 3)``, sRGB, as one endless .gif or .webp; complete or not at all."""
    form = path.suffix[1:].upper()
    images = [PIL.Image.fromarray(picture) for picture in pictures]
    if form == "GIF":  # 256 colours a frame: dithered, because smooth blur shows bands
        images = [image.quantize(palette=image.quantize()) for image in images]
    with replace_files(path) as [temporary], temporary.open("wb") as file:
        images[0].save(
            file,
            format=form,
            save_all=True,
            append_images=images[1:],
            duration=round(1000 / fps),
            loop=0,
            quality=90,
        )
