"""From planes to images.

A pixel is the mean of views: lens points and times, each with a place within the pixel. A view lays the
planes behind one another, front to back, each shifted by ``C (u, v) + M (t - 1/2)`` (layered, Eq. 33, before
any of its approximations), until nothing shines through. What is missing behind the last plane counts as what
was seen.

Maps are blurred themselves: by sharing rays out among cells, by interpolating between cells, and on purpose
(`smoothing`). Their variance is taken off that of the pixel filter and the lens: a plane is
looked at from lens points, and places within the pixel, that are closer together.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from fewrays import _native
from fewrays.aperture_options import ApertureOptions
from fewrays.errors import require_option
from fewrays.lens import Lens
from fewrays.multiplane.copies import Copies, farthest_shifts
from fewrays.multiplane.maps import Maps
from fewrays.multiplane.smoothing import Smoothing, distance_between
from fewrays.parallel import Execution, map_ranges, progress_bar
from fewrays.pixel_filter import PixelFilter, PixelFilterShape
from fewrays.temporal.locations import Locations, make_locations
from fewrays.temporal.shutter import Shutter, ShutterResponse
from fewrays.vignetting import CatsEye

__all__ = ["RenderOptions", "render_maps", "shrink_of"]

_LEAST_SHARE = 0.1  # of a variance that is left


@dataclass(frozen=True, kw_only=True)
class RenderOptions(ApertureOptions):
    """How an image is made of planes."""

    views: int = 128
    """Lens points, times and places that every pixel is the mean of: 64 for a draft, 256 for the last bit."""
    smoothing: float = 0.29
    """Gaussian that widely blurred planes are smoothed with, in units of the distance that blur puts between
    neighbouring lens points; 0 for none."""
    pixel_filter: PixelFilterShape = "box"
    """Pixel filter."""
    sigma_pix: float = 0.5
    """Standard deviation of the Gaussian pixel filter, in pixels."""
    cats_eye: float = 0.0
    """Optical vignetting: how far the rim covers the aperture in the corners, in lens radii."""
    darken: bool = False
    """Whether optical vignetting darkens the corners, or only changes the shape of what is blurred."""
    shutter: tuple[float, float] = (0.0, 1.0)
    """When the shutter opens and closes, in [0, 1] over the shutter of the samples."""
    shutter_response: ShutterResponse = "box"
    """How open the shutter is in between."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole = isinstance(self.views, int) and 1 <= self.views <= 65536
        require_option("views", self.views, whole, "that is a whole number from 1 to 65536")
        require_option("smoothing", self.smoothing, 0 <= self.smoothing <= 2, "from 0 to 2")
        self.vignetting()
        self.filter_of_pixels()
        self.open_shutter()

    def filter_of_pixels(self) -> PixelFilter:
        """Return the pixel filter."""
        return PixelFilter(self.pixel_filter, self.sigma_pix)

    def open_shutter(self) -> Shutter:
        """Return the shutter."""
        return Shutter(*self.shutter, self.shutter_response)

    def vignetting(self) -> CatsEye:
        """Return the optical vignetting."""
        return CatsEye(self.cats_eye, self.darken)

    def locations(self, lens: Lens) -> Locations:
        """Return what every pixel looks at."""
        return make_locations(
            self.views, self.aperture_of(lens), self.filter_of_pixels(), self.open_shutter()
        )

    def smoothing_of(
        self, slope: npt.NDArray[np.float64], cells: npt.NDArray[np.int32], lens: Lens, where: Locations
    ) -> Smoothing:
        """Return how planes of slopes (K,) and cells (K,) are smoothed for the lens points of `where`."""
        distance = distance_between(self.aperture_of(lens), where)
        return Smoothing.of_views(slope, cells, distance, self.smoothing)


def render_maps(
    maps: Maps, lens: Lens | None, options: RenderOptions, execution: Execution
) -> npt.NDArray[np.float32]:
    """Make an image; see `Multiplane.render`.

    Returns
    -------
    ndarray of float32, (H, W, 4)
        Radiance, and the share of the light whose origin the maps know.
    """
    seen = maps.through(lens or maps.lens)
    where = options.locations(seen.lens)
    rim = _native.FrontRim(**asdict(options.vignetting().front_rim(where.uv, maps.height, maps.width)))
    smoothing = options.smoothing_of(seen.shear.slope, seen.grid.cells, seen.lens, where)
    shrink = shrink_of(seen.shear.slope, smoothing.variance, where).astype(np.float32)
    views = np.column_stack([where.uv, where.t, where.offset, where.weight]).astype(np.float32)
    image = np.zeros((maps.height, maps.width, 4), np.float32)
    copies = Copies.of_maps(seen, smoothing)
    native, is_halved = copies.native(), copies.is_halved.astype(np.uint8)
    is_smoothed = (smoothing.sigma > 0).astype(np.uint8)
    farthest = farthest_shifts(seen.shear, shrink, where)
    columns = -(-maps.width // _native.TILE_COLUMNS)

    def render_band(first_row: int, end_row: int, bar: tqdm[Any]) -> None:
        band = copies.smooth_band((first_row, end_row), farthest[:, 1], execution)

        def work(first: int, last: int) -> None:
            _native.multiplane_render(
                native,
                band.slots,
                seen.halves,
                band.halves,
                is_smoothed,
                is_halved,
                views=views,
                shrink=shrink,
                reach=farthest.astype(np.float32),
                rim=rim,
                vignetted=options.cats_eye > 0,
                darken=options.darken,
                first=first_row * columns + first,
                last=first_row * columns + last,
                image=image,
            )

        map_ranges(work, (end_row - first_row) * columns, execution, bar=bar, chunk=4)

    tiles = -(-maps.height // _native.TILE_ROWS) * columns
    with progress_bar(tiles, "multiplane: render", show=execution.progress, unit="tile") as bar:
        for first, end in copies.bands():
            render_band(first, end, bar)
    return image


def shrink_of(
    slope: npt.NDArray[np.float64], own: npt.NDArray[np.float64], where: Locations
) -> npt.NDArray[np.float64]:
    """Return by how much each plane's views draw together to make up for the blur of its map, (K,).

    `own` is the variance of that blur, (K,): `Smoothing.variance`.
    """
    weight = where.weight[:, None].astype(np.float64)
    of_pixel = float((np.square(where.offset, dtype=np.float64) * weight).sum() / 2)
    of_lens = float((np.square(where.uv, dtype=np.float64) * weight).sum() / 2)
    wanted = of_pixel + np.square(slope) * of_lens
    left: npt.NDArray[np.float64] = np.sqrt(np.maximum(1 - own / np.maximum(wanted, 1e-12), _LEAST_SHARE))
    return left
