"""Samples of any size, whose depth complexity is known, without a renderer."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow
from PIL import ImageDraw

import fewrays
from contenders import PUBLISHED
from fewrays.sources.analytic import Mask, Plane, sample, smooth_noise
from fewrays.sources.analytic_shadows import Ball, Camera, Scene, Sheet, aimed, box, render_lit

__all__ = ["LEAF_LENS", "count_layers", "leaf_planes", "leaf_stack", "lit_ground", "repeated", "seen_from"]

LEAF_LENS = fewrays.Lens(-40.0, 10.0, aperture="gaussian", sampling="square")
_CELL = 128  # pixels; each leafy plane has one leaf in some of these
_LAYERS: dict[str, Any] = {
    "partitions": 25,
    "partition_sigma_x": 16.0,
}  # as in the layered method's first version


def leaf_planes(
    height: int, width: int, spp: int, *, aperture_scale: float = 1.0, planes: int = 20, seed: int = 0
) -> fewrays.SampleBuffer:
    """Sample planes of scattered leaves in front of and behind the focal plane, and a wall behind them.

    Parameters
    ----------
    height, width : int
        In pixels.
    spp : int
        Samples per pixel; their lens positions are uniform over the square, for a Gaussian lens.
    aperture_scale : float
        Factor on the lens radius, hence on all slopes.
    planes : int
        Leafy planes.
    seed : int
        The same seed gives the same samples.

    Returns
    -------
    SampleBuffer
    """
    lens = LEAF_LENS.refocus(aperture_scale=aperture_scale)
    return sample(leaf_stack(height, width, planes=planes, seed=seed), lens, height, width, spp, seed=seed)


def leaf_stack(
    height: int, width: int, *, planes: int = 20, share: float = 0.27, seed: int = 0
) -> list[Plane]:
    """Return the planes: leaves at slopes from -16 to 7 px through `LEAF_LENS`, and the wall at 8 px.

    Parameters
    ----------
    height, width : int
        Of the image that they fill, in pixels.
    planes : int
        Leafy planes.
    share : float
        Of the cells of 128 x 128 pixels, those that hold a leaf, in each plane.
    seed : int
        The same seed gives the same planes.

    Returns
    -------
    list of Plane
        The wall, which covers everything, first.
    """
    rng = np.random.default_rng(seed)
    wall = smooth_noise(12.0, mean=rng.uniform(0.3, 0.9, 3).tolist(), seed=seed)
    stack = [Plane(LEAF_LENS.depth(8.0), wall)]
    for number, slope in enumerate(np.linspace(-16, 7, planes)):
        color = smooth_noise(6.0, mean=rng.uniform(0.2, 0.8, 3).tolist(), waves=8, seed=seed + 1 + number)
        stack.append(Plane(LEAF_LENS.depth(float(slope)), color, _leaves(height, width, share, rng)))
    return stack


def lit_ground(height: int, width: int, spp: int) -> fewrays.SampleBuffer:
    """Sample balls and boxes on the ground under two lamps, of which a fifth of the samples sees only parts.

    Parameters
    ----------
    height, width : int
        In pixels.
    spp : int
        Samples per pixel, each with a light sample of both lamps.
    """
    camera = Camera(height, width, position=(0, 3, 4), target=(0, 0.3, 0), fov=45, lens_radius=0.05)
    things = [
        thing
        for x in (-1.5, 0.0, 1.5)
        for thing in (Ball((x, 0.4, 0.3), 0.4), *box((x + 0.6, 0, -0.6), (0.3, 0.2), 0.7, turn=30.0))
    ]
    lamps = [
        aimed((1, 4, 1), (0, 0, 0), (0.6, 0.3), radiance=(10, 8, 6)),
        aimed((-2, 3, 1), (0, 0, 0), (0.3, 0.5), "disc", radiance=(4, 8, 2)),
    ]
    return render_lit(Scene(camera, [Sheet((0, 0, 0), (0, 1, 0), (1, 0, 0)), *things], lamps), spp)


def repeated(samples: fewrays.SampleBuffer, times: int) -> fewrays.SampleBuffer:
    """Return samples several times side by side, and as often one below the other."""

    def tiled(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return np.tile(values, (times, times) + (1,) * (values.ndim - 2))

    size = np.array((samples.width, samples.height))
    row, column = np.indices((times * samples.height, times * samples.width))
    corner = np.stack([column, row], axis=-1) // size * size
    xy = (tiled(samples.xy) + corner[:, :, None]).astype(np.float32)
    return fewrays.SampleBuffer(
        xy, tiled(samples.uv), tiled(samples.depth), tiled(samples.color), samples.lens
    )


def seen_from(plane: Plane, column: int, row: int) -> Plane:
    """Return a plane as the image sees it whose left upper corner is that pixel of the plane's own image."""
    corner = np.array([column, row], np.float64)
    mask = plane.mask
    shifted: Mask | None = None if mask is None else lambda xy: mask(xy + corner)
    x, y, w = plane.motion
    motion = (x - column * w, y - row * w, w)
    return Plane(plane.depth, lambda xy: plane.color(xy + corner), shifted, motion)


def count_layers(samples: fewrays.SampleBuffer) -> float:
    """Return the mean number of depth layers that occur around a pixel.

    Counted as the first version of the layered method did, in tiles of 32 pixels with a ring of 16, so that a
    workload keeps its number whatever the methods do.
    """
    _, aovs = fewrays.reconstruct(samples, PUBLISHED, aovs=True, **_LAYERS)
    return float(aovs["layer_count"].mean())


def _leaves(height: int, width: int, share: float, rng: np.random.Generator) -> Mask:
    """Return a mask of slender polygons, one in each of the chosen cells."""
    picture = Pillow.new("1", (width, height))
    draw = ImageDraw.Draw(picture)
    for top in range(0, height, _CELL):
        for left in range(0, width, _CELL):
            if rng.random() >= share:
                continue
            center = np.array([left, top]) + rng.uniform(0, _CELL, 2)
            draw.polygon([tuple(corner) for corner in _leaf(center, rng)], fill=1)
    inside = np.asarray(picture)

    def mask(xy: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        # Positions beyond the image see its other side: the lens must not look past the leaves' end.
        column, row = np.floor(xy).astype(np.int64).T
        result: npt.NDArray[np.bool_] = inside[row % height, column % width]
        return result

    return mask


def _leaf(center: npt.NDArray[np.float64], rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Corners (16, 2) of an ellipse of random size and direction."""
    around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    length = rng.uniform(0.15, 0.4) * _CELL
    along, across = length * np.cos(around), 0.4 * length * np.sin(around)
    turn = rng.uniform(0, np.pi)
    corners = [along * np.cos(turn) - across * np.sin(turn), along * np.sin(turn) + across * np.cos(turn)]
    return np.asarray(center + np.stack(corners, axis=-1))
