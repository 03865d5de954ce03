"""``fewrays defocus``: a pinhole picture with depth in, depth of field out, as one image or a focus pull."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
import numpy.typing as npt
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from fewrays import __version__
from fewrays.cli.camera import CameraFlags, depth_at
from fewrays.cli.command import IMAGE_SUFFIXES, Command, check_output, stopwatch
from fewrays.cli.sequence import (
    Ease,
    check_sequence,
    focus_distances,
    frame_path,
    is_animation,
    save_animation,
)
from fewrays.display import tone_map
from fewrays.dynamic import DefocusOptions, DepthLayer, defocus_rgba
from fewrays.errors import SampleError
from fewrays.io import save_image
from fewrays.io.image_rgba import save_rgba
from fewrays.io.rgbz import RgbzImage, RgbzSource, load_rgbz
from fewrays.io.rgbz_channels import DepthKind
from fewrays.io.rgbz_depth import FAR, DepthFormat, InvalidDepth
from fewrays.lens import Lens
from fewrays.parallel import progress_bar

__all__ = ["Defocus", "DepthFlags"]

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class DepthFlags:
    """How the picture and its depth are read.

    Parameters
    ----------
    depth_kind
        What the depth is: along the optical axis, along the ray (needs --fov or --focal-length), or
        1 / planar. As the channel's name says unless given, which nearly always means planar.
    depth_scale
        Factor on the stored depth that gives scene units; for 16 bit .png, and where the camera looks
        along -z.
    background
        Depths from here on, in scene units, count as infinitely far.
    color_layer
        The EXR's layer with the picture, such as 'ViewLayer.Combined'; found by its name unless given.
    depth_channel
        The EXR's channel with depth, such as 'ViewLayer.Depth.Z'; found by its name unless given.
    use_alpha
        Whether an alpha channel counts.
    deep_layers
        Most layers that a deep EXR is sorted into.
    """

    depth_kind: DepthKind | None = None
    depth_scale: float = 1.0
    background: float = FAR
    color_layer: str | None = None
    depth_channel: str | None = None
    use_alpha: bool = True
    deep_layers: int = 4

    def source(self, focal_widths: float | None, invalid: InvalidDepth) -> RgbzSource:
        """Return where in the files colour and depth are."""
        return RgbzSource(
            DepthFormat(self.depth_kind, self.depth_scale, self.background, invalid),
            self.color_layer,
            self.depth_channel,
            focal_widths,
            self.use_alpha,
            self.deep_layers,
        )


@dataclass(frozen=True)
class Defocus(Command):
    """Give depth of field to a picture with depth: one image, or a focus pull.

    The picture is a pinhole render, .exr with colour and depth as Blender, Mitsuba, pbrt, Arnold, Unreal and
    others write them, flat or deep; or any image with depth in a file of its own. Say what is in focus
    (--focus-distance or --focus-at) and how large the blur is (--f-number, --lens-radius or --max-coc).

    Parameters
    ----------
    image
        The picture: .exr; with --depth also .png and .npy.
    out
        The image to write: .exr (linear), .png (sRGB) or .npy; with alpha where the picture has some. For a
        focus pull images with the frame's number (%03d or {} in the name), or one .gif or .webp.
    depth
        Depth in a file of its own: .exr, .npy or 16 bit .png.
    behind
        What lies behind the picture (a depth peel), as a picture with depth; may be given again for what lies
        behind that. Makes the edges of blurred foregrounds exact.
    focus_distance
        Depth of the focal plane in scene units; 'inf' allowed.
    focus_at
        Column and row of a pixel that shall be in focus, instead; given twice, where a focus pull begins and
        ends.
    to
        Depth of the focal plane at the end of a focus pull.
    frames
        Number of images of a focus pull, at least 2; evenly spaced in 1 / distance.
    ease
        Start the focus pull slowly ('in'), end slowly ('out'), or both.
    fps
        Frames per second of an animation.
    exposure
        Brightening of .png, .gif and .webp, in stops.
    device
        'cuda' is an NVIDIA GPU, which 'auto' takes where there is one; 'reference' is plain NumPy, slow.
    threads
        Threads to use; all usable cores when omitted. The result does not depend on it.
    """

    examples: ClassVar[tuple[str, ...]] = (
        "fewrays defocus shot.exr --out soft.exr --focus-distance 3.2 --f-number 1.8 --focal-length 50",
        "fewrays defocus shot.exr --out soft.png --focus-at 640 360 --max-coc 12 --views 64",
        "fewrays defocus beauty.png --depth depth.png --depth-scale 0.001 --out soft.png --focus-distance 2 "
        "--lens-radius 0.02 --fov 40",
        "fewrays defocus shot.exr --behind peel.exr --out soft.exr --focus-distance 4 --max-coc 20",
        "fewrays defocus shot.exr --out pull.gif --focus-at 100 200 --focus-at 500 90 --max-coc 15 "
        "--ease in-out",
    )

    image: Annotated[Positional[Path], arg(metavar="IMAGE")]
    out: Path
    depth: Annotated[Path | None, arg(metavar="FILE")] = None
    behind: Annotated[UseAppendAction[tuple[Path, ...]], arg(metavar="FILE")] = ()
    focus_distance: float | None = None
    focus_at: Annotated[UseAppendAction[tuple[tuple[int, int], ...]], arg(metavar="X Y")] = ()
    to: float | None = None
    frames: int = 24
    ease: Ease = "none"
    fps: float = 24.0
    exposure: float = 0.0
    device: Literal["auto", "cpu", "reference", "cuda"] = "auto"
    threads: int | None = None
    camera: OmitArgPrefixes[CameraFlags] = field(default_factory=CameraFlags)
    reading: OmitArgPrefixes[DepthFlags] = field(default_factory=DepthFlags)
    options: Annotated[OmitArgPrefixes[DefocusOptions], arg(name="method")] = field(
        default_factory=DefocusOptions
    )

    def run(self) -> None:
        """Read the picture, find the lens, defocus and save."""
        self._check()
        layers, picture = self._load()
        lenses = self._lenses(picture)
        with stopwatch() as watch:
            written = (
                self._save_sequence(layers, lenses) if self._pulls else self._save_one(layers, lenses[0])
            )
        what = f"{len(lenses)} frames" if self._pulls else f"focused at {lenses[0].focus_distance:.6g}"
        height, width = picture.size
        print(
            f"defocus: {what}, {width} x {height}, {self.options.views} views, {watch.seconds:.2f} s "
            f"-> {written}"
        )

    @property
    def _pulls(self) -> bool:
        """Whether a focus pull is asked for."""
        return self.to is not None or len(self.focus_at) == 2

    def _check(self) -> None:
        """Refuse what cannot work before anything is loaded."""
        pixels = len(self.focus_at)
        starts = (self.focus_distance is not None) + min(pixels, 1)
        ends = (self.to is not None) + max(pixels - 1, 0)
        if starts > 1 or ends > 1:
            raise SampleError(
                "too much says where the focus is: give --focus-distance or --focus-at, and for a focus pull "
                "--to or a second --focus-at",
                field="focus_at",
            )
        if self._pulls:
            check_sequence(self.out, self.frames, self.fps, self.exposure)
            return
        if is_animation(self.out):
            raise SampleError("an animation needs --to, or --focus-at twice", file=self.out)
        check_output(self.out, IMAGE_SUFFIXES)
        if self.exposure and self.out.suffix.lower() != ".png":
            raise SampleError("is for .png; other formats store the radiance itself", field="exposure")

    def _load(self) -> tuple[tuple[DepthLayer, ...], RgbzImage]:
        """Return all layers, nearest first, and the picture they begin with."""
        source = self.reading.source(self.camera.focal_widths, self.options.invalid_depth)
        picture = load_rgbz(self.image, self.depth, source)
        layers = list(picture.layers)
        for path in self.behind:
            peel = load_rgbz(path, None, source)
            if peel.size != picture.size:
                raise SampleError(
                    f"is {peel.size[1]} x {peel.size[0]} pixels, {self.image} {picture.size[1]} x "
                    f"{picture.size[0]}",
                    file=path,
                )
            layers += peel.layers
        return tuple(layers), picture

    def _lenses(self, picture: RgbzImage) -> list[Lens]:
        """Return the lens of every frame."""
        seen = [depth_at(picture, column, row) for column, row in self.focus_at]
        first = self.camera.lens(picture, seen[0] if seen else self.focus_distance)
        if not self._pulls:
            return [first]
        if first.c0 == 0:
            raise SampleError("is a pinhole, for which everything is in focus", field="lens")
        last = seen[1] if self.to is None else self.to
        distances = focus_distances(first.focus_distance, last, self.frames, self.ease)
        return [first.refocus(distance) for distance in distances]

    def _defocus(self, layers: Sequence[DepthLayer], lens: Lens, progress: bool) -> Float32:
        front, *behind = layers
        return defocus_rgba(
            front.color,
            front.depth,
            lens,
            alpha=front.alpha,
            behind=behind,
            device=self.device,
            threads=self.threads,
            progress=progress,
            **{f.name: getattr(self.options, f.name) for f in dataclasses.fields(self.options)},
        )

    def _save_one(self, layers: Sequence[DepthLayer], lens: Lens) -> str:
        self._save(self.out, self._defocus(layers, lens, True), layers, lens)
        return str(self.out)

    def _save_sequence(self, layers: Sequence[DepthLayer], lenses: Sequence[Lens]) -> str:
        if is_animation(self.out):
            pictures = [tone_map(image[..., :3], self.exposure) for image in self._frames(layers, lenses)]
            save_animation(self.out, pictures, self.fps)
            return str(self.out)
        paths = [frame_path(self.out, number) for number in range(1, self.frames + 1)]
        for path, lens, image in zip(paths, lenses, self._frames(layers, lenses), strict=True):
            self._save(path, image, layers, lens)
        return f"{paths[0]} ... {paths[-1].name}"

    def _frames(self, layers: Sequence[DepthLayer], lenses: Sequence[Lens]) -> Iterator[Float32]:
        with progress_bar(len(lenses), "defocus", show=True, unit="frame") as bar:
            for lens in lenses:
                yield self._defocus(layers, lens, False)
                bar.update()

    def _save(self, path: Path, image: Float32, layers: Sequence[DepthLayer], lens: Lens) -> None:
        notes = {
            "software": f"fewrays {__version__}",
            "method": "dynamic",
            "options": ", ".join(f"{name}={value}" for name, value in asdict(self.options).items()),
            "lens": str(lens),
            "image": self.image.name,
        }
        if layers[0].alpha is None:
            save_image(path, image[..., :3], exposure=self.exposure, provenance=notes)
        else:
            save_rgba(path, image, exposure=self.exposure, provenance=notes)
