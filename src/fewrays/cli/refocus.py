"""``fewrays refocus``: a rack-focus sequence from one file of samples.

The samples stay as they are; every frame looks at them through a lens that is focused elsewhere (temporal,
section 6 and Figure 13). What a method can do before it knows the lens, it does once for all frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Generic, Literal, TypeVar

import numpy as np
from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from fewrays.cli.command import Command, InputFlags, SamplesFile, stopwatch
from fewrays.cli.methods import DEFAULT_METHOD, provenance
from fewrays.cli.sequence import (
    Ease,
    check_sequence,
    focus_distances,
    frame_path,
    is_animation,
    save_animation,
)
from fewrays.cli.source import Source, open_source
from fewrays.display import tone_map
from fewrays.errors import SampleError
from fewrays.io import save_image
from fewrays.method import Image
from fewrays.parallel import Execution, progress_bar
from fewrays.reconstruct import METHODS, find_method
from fewrays.samples import SampleBuffer

__all__ = ["Refocus", "depth_at"]

Options = TypeVar("Options")


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
        'cuda' is an NVIDIA GPU, which 'auto' takes where there is one; 'reference' is plain NumPy, slow.
    threads
        Threads to use; all usable cores when omitted. The result does not depend on it.
    exposure
        Brightening of .png, .gif and .webp, in stops.
    shadows
        Reconstruct soft shadows where samples come with light samples; '--no-shadows' takes them as they are.
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
    device: Literal["auto", "cpu", "reference", "cuda"] = "auto"
    threads: int | None = None
    exposure: float = 0.0
    shadows: bool = True
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
            if is_animation(self.out):
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
        check_sequence(self.out, self.frames, self.fps, self.exposure)
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
            render = source.renderer(self.options, Execution(self.device, self.threads, shadows=self.shadows))
            for lens in lenses:
                yield render(lens).image, provenance(method, self.options, lens, self.samples)
                bar.update()


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
