"""Penumbrae whose shape is known: a half-plane and a disc between a floor and a lamp, 4 samples per pixel."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

import fewrays
from fewrays.display import save_picture
from fewrays.method import Image
from fewrays.sources.analytic_shadows import (
    Camera,
    Disc,
    HalfPlane,
    Scene,
    Sheet,
    aimed,
    render_lit,
    true_image,
)
from fewrays.sources.outlines import Outline
from pictures import Curve, line_chart
from report import markdown_table, met

__all__ = ["SIDES", "Penumbra", "Profile", "draw_profiles", "measure_penumbrae", "section"]

SPP = 4
SIDES = (40, 200)
"""Pixels along the image's sides: penumbrae are some 12 of them wide, or some 60."""
TARGET = 0.01
"""Largest root-mean-square error of a profile, as a share of the light."""

_BORDER = 0.1  # share of the image's side that samples outside of it would have helped with
_STEPS = 10  # shares of the light that a profile tells apart
_LEAST = 16  # pixels that make a mean
_FLOOR = Sheet((0, 0, 0), (0, 1, 0), (1, 0, 0))
_HIGH = (0.0, 4.0, 0.0)
_LAMPS = {
    "square": aimed(_HIGH, (0, 0, 0), (0.8, 0.8), radiance=(10, 10, 10)),
    "round": aimed(_HIGH, (0, 0, 0), (0.8, 0.8), "disc", radiance=(10, 10, 10)),
}
_OCCLUDERS: dict[str, tuple[float, Outline]] = {
    "half-plane": (1.5, HalfPlane((0.02, 0), (1, 0))),
    "disc": (1.2, Disc((0.02, 0.05), 0.6)),
}
_PLAIN, _PUBLISHED, _OURS = "plain average", "temporal, light at locations", "box of shaded samples"

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Profile:
    """Errors as shares of the light: of the profile, its worst step, and root mean square of the pixels'."""

    rms: float
    worst: float
    of_pixels: float


@dataclass(frozen=True)
class Penumbra:
    """A penumbra, everyone's errors in it, and each one's middle row of pixels.

    Parameters
    ----------
    occluder, lamp : str
    side : int
        Of the image, in pixels.
    profiles : dict of str to Profile
    rows : dict of str to ndarray, (side,)
        Shares of the light, the truth among them.
    """

    occluder: str
    lamp: str
    side: int
    profiles: dict[str, Profile]
    rows: dict[str, Floats]


def measure_penumbrae() -> list[Penumbra]:
    """Measure every occluder under every lamp at every resolution."""
    return [_measure(occluder, lamp, side) for side in SIDES for occluder in _OCCLUDERS for lamp in _LAMPS]


def _measure(occluder: str, lamp: str, side: int) -> Penumbra:
    print(f"penumbra: {occluder}, {lamp}, {side} px", file=sys.stderr)
    camera = Camera(side, side, position=(0, 6, 0), target=(0, 0, 0), up=(0, 0, -1), fov=30)
    height, outline = _OCCLUDERS[occluder]
    # The camera does not see the occluder, so that all of its penumbra is in the picture.
    sheet = Sheet((0, height, 0), (0, 1, 0), (1, 0, 0), outline, seen=False)
    scene = Scene(camera, [_FLOOR, sheet], [_LAMPS[lamp]])
    samples = render_lit(scene, SPP)
    alone = _truth(replace(scene, shapes=[_FLOOR]))
    exact = _truth(scene) / alone
    ways: dict[str, Callable[[], Image]] = {
        _PLAIN: lambda: fewrays.reconstruct(samples, "box", shadows=False),
        _PUBLISHED: lambda: fewrays.reconstruct(samples, "temporal", light_at="locations"),
        _OURS: lambda: fewrays.reconstruct(samples, "box"),
    }
    shares = {name: _inner(make()) / alone for name, make in ways.items()}
    profiles = {name: _profile(share, exact) for name, share in shares.items()}
    middle = len(exact) // 2
    rows = {name: share[middle] for name, share in {**shares, "truth": exact}.items()}
    return Penumbra(occluder, lamp, side, profiles, rows)


def _truth(scene: Scene) -> Floats:
    return _inner(true_image(scene, rays=4, tolerance=1e-3))


def _inner(image: Image) -> Floats:
    border = round(_BORDER * len(image))
    return image[border:-border, border:-border, 0].astype(np.float64)


def _profile(share: Floats, exact: Floats) -> Profile:
    """Compare means over all pixels that truly get about the same light."""
    penumbra = (exact > 0.01) & (exact < 0.99)
    step = np.floor(_STEPS * exact[penumbra]).astype(int)
    count = np.bincount(step, minlength=_STEPS)
    error = (share - exact)[penumbra]
    enough = count >= _LEAST
    mean = np.bincount(step, error, minlength=_STEPS)[enough] / count[enough]
    return Profile(_rms(mean), float(np.abs(mean).max()), _rms(error))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.square(values).mean()))


def draw_profiles(measured: Sequence[Penumbra], path: Path) -> None:
    """Draw the middle row of pixels across the larger pictures' penumbrae under the square lamp."""
    charts: dict[str, dict[str, Curve]] = {}
    for one in measured:
        if (one.side, one.lamp) == (max(SIDES), "square"):
            place = np.arange(len(one.rows["truth"]), dtype=np.float64)
            names = (_PLAIN, _PUBLISHED, _OURS, "truth")
            charts[f"A row of pixels under a {one.occluder}"] = {n: (place, one.rows[n]) for n in names}
    save_picture(path, line_chart(charts, "pixel", "share of the light"))


def section(measured: Sequence[Penumbra], picture: str) -> Iterator[str]:
    """Return the page's part on penumbrae."""
    yield "## Penumbrae of known shape"
    yield (
        "A floor under a square or a round lamp, and between them a half-plane or a disc that the camera "
        f"does not see, at {SPP} samples per pixel; the truth is integrated over the lamp. The profile is "
        f"the mean over all pixels that truly get the same tenth of the light. Its root-mean-square error in "
        "percent of the light, in brackets the largest of a tenth, and behind the dot the root-mean-square "
        "error of single pixels, noise included."
    )
    names = list(measured[0].profiles)
    rows = [
        [
            f"{one.occluder}, {one.lamp} lamp, {one.side} x {one.side} px",
            *(_cell(one.profiles[name]) for name in names),
        ]
        for one in measured
    ]
    yield markdown_table(["", *names], rows)
    for name in (_OURS, _PUBLISHED):
        worst = max(measured, key=lambda one: one.profiles[name].rms)
        error = worst.profiles[name].rms
        yield (
            f"Target: profiles to {TARGET:.0%}, {name}. {met(error <= TARGET)}: at most {error:.2%} "
            f"({worst.occluder}, {worst.lamp} lamp, {worst.side} px)."
        )
    yield f"![Rows of pixels across penumbrae]({picture})"


def _cell(profile: Profile) -> str:
    return f"{profile.rms:.2%} ({profile.worst:.2%}) · {profile.of_pixels:.1%}"
