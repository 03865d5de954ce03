"""``fewrays info``: what a file of samples holds, or of what a method has prepared of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from tyro.conf import OmitArgPrefixes

from fewrays.cli.command import Command, InputFlags, SamplesFile
from fewrays.cli.source import preparing_method
from fewrays.lens import Lens
from fewrays.lighting import Lighting
from fewrays.method import Preparation
from fewrays.samples import SampleBuffer

__all__ = ["Info", "describe"]

_PERCENTILES = {"min": 0, "1%": 1, "25%": 25, "median": 50, "75%": 75, "99%": 99, "max": 100}
_DARKEST = 1e-30  # mean radiance below which an image is black


@dataclass(frozen=True)
class Info(Command):
    """Show what a file of samples or planes holds: size, fields, lens, blur, depth, placement.

    The input options show it as another lens would see it.

    Parameters
    ----------
    samples
        The samples: .npz, version 1.3 (.tlfr, .bin, .txt), or deep .exr. Or the .planes of 'fewrays planes'.
    """

    examples: ClassVar[tuple[str, ...]] = (
        "fewrays info samples.npz",
        "fewrays info samples.npz --focus-distance 3.5",
        "fewrays info scene.planes",
    )

    samples: SamplesFile
    input: OmitArgPrefixes[InputFlags] = field(default_factory=InputFlags)

    def run(self) -> None:
        """Print the description."""
        method = preparing_method(self.samples)
        if method is not None and method.preparation is not None:
            found = self._describe_prepared(method.preparation)
        else:
            found = describe(self.input.load(self.samples))
        lines = {"file": str(self.samples), **found}
        print("\n".join(f"{name:<10} {text}" for name, text in lines.items()))

    def _describe_prepared(self, preparation: Preparation) -> dict[str, str]:
        prepared = preparation.load(self.samples)
        lens = self.input.lens_for(prepared.lens, self.samples)
        return {
            "size": f"{prepared.width} x {prepared.height} pixels",
            "lens": describe_lens(lens),
            "aperture": f"{lens.aperture}, sigma {lens.sigma:.6g}",
            **prepared.describe(lens),
        }


def describe(samples: SampleBuffer) -> dict[str, str]:
    """Return what there is to say about samples, one short text per heading."""
    lens = samples.lens
    total = samples.depth.size
    own, off = placement(samples)
    slope = np.percentile(samples.slope(), list(_PERCENTILES.values()))
    depth = np.percentile(samples.depth, (0, 50, 100))
    color = samples.color
    return {
        "size": f"{samples.width} x {samples.height} pixels, {samples.spp} spp, {total:,} samples",
        "fields": f"{' '.join(samples.field_names())}; {samples.nbytes / 2**20:.1f} MiB in memory",
        "lens": describe_lens(lens),
        "aperture": f"{lens.aperture}, samples drawn from {lens.sampling}, sigma {lens.sigma:.6g}; "
        f"worth {effective_spp(samples):.1f} spp for plain averaging",
        "slope": ", ".join(f"{name} {value:.4g}" for name, value in zip(_PERCENTILES, slope, strict=True))
        + " px",
        "depth": f"{depth[0]:.6g} to {depth[2]:.6g}, median {depth[1]:.6g}",
        "radiance": f"{color.min():.4g} to {color.max():.4g}, mean {color.mean(dtype=np.float64):.4g}",
        "placement": f"{own:.2%} of the samples lie in their own pixel, {off:.2%} off the image",
        **({} if samples.lighting is None else describe_lighting(samples, samples.lighting)),
    }


def describe_lighting(samples: SampleBuffer, lighting: Lighting) -> dict[str, str]:
    """Return what there is to say about area lights, and whether the colours are what they make."""
    found = {}
    for number, each in enumerate(lighting.lights):
        light = each.light
        size = " x ".join(f"{2 * half:.4g}" for half in light.half_size)
        center = ", ".join(f"{value:.4g}" for value in light.center)
        aimed = each.density > 0
        lit = float(lighting.arrives(samples, number)[aimed].mean()) if aimed.any() else 0.0
        found[f"light {number}"] = (
            f"{light.shape}, {size}, at ({center}) from the lens{', moving' if light.moves else ''}; "
            f"{aimed.mean():.2%} of the samples have a light sample, {lit:.2%} of which arrive"
        )
    color = samples.color.astype(np.float64)
    off = np.abs(color - lighting.color(samples)).mean() / max(float(np.abs(color).mean()), _DARKEST)
    found["unlit"] = (
        f"mean {lighting.unlit.mean(dtype=np.float64):.4g}; it and the lights' direct light differ from the "
        f"radiance by {off:.1e} of its mean"
    )
    return found


def describe_lens(lens: Lens) -> str:
    """Return a lens's coefficients and its focus in words."""
    return f"slope = {lens.c0:.6g} / depth + {lens.c1:.6g} px (c0, c1), focused at {lens.focus_distance:.6g}"


def placement(samples: SampleBuffer) -> tuple[float, float]:
    """Return the shares of samples that lie in their own pixel, and off the image."""
    x, y = samples.xy[..., 0], samples.xy[..., 1]
    columns = np.arange(samples.width, dtype=np.float32)[None, :, None]
    rows = np.arange(samples.height, dtype=np.float32)[:, None, None]
    own = (x >= columns) & (x < columns + 1) & (y >= rows) & (y < rows + 1)
    off = (x < 0) | (x >= samples.width) | (y < 0) | (y >= samples.height)
    return float(own.mean()), float(off.mean())


def effective_spp(samples: SampleBuffer) -> float:
    """Return the equally weighted samples per pixel that average to the same variance: (Σw)² / Σw²."""
    weights = samples.lens.weights(samples.uv).astype(np.float64, copy=False)
    squares = float(np.square(weights).sum())
    return samples.spp * float(weights.sum()) ** 2 / (squares * weights.size) if squares else 0.0
