"""From planes to images.

A pixel is the mean of views: lens points and times, each with a place within the pixel. A view lays the
planes behind one another, front to back, each shifted by ``C (u, v) + M (t - 1/2)`` (layered, Eq. 33, before
any of its approximations), until nothing shines through. What is missing behind the last plane counts as what
was seen.

Maps are blurred themselves: by sharing rays out among cells, by interpolating between cells, and on purpose
(`BuildOptions.smoothing`). Their variance is taken off that of the pixel filter and the lens: a plane is
looked at from lens points, and places within the pixel, that are closer together.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.aperture_options import ApertureOptions
from fewrays.errors import require_option
from fewrays.lens import Lens
from fewrays.multiplane.maps import Maps, Shear
from fewrays.parallel import Execution, map_ranges
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
    rim = options.vignetting().front_rim(where.uv, maps.height, maps.width)
    image = np.zeros((maps.height, maps.width, 4), np.float32)
    native = seen.native()
    views = np.column_stack([where.uv, where.t, where.offset, where.weight]).astype(np.float32)
    shrink = shrink_of(seen.shear, seen.grid.cells, where).astype(np.float32)

    def work(first: int, last: int) -> None:
        _native.multiplane_render(
            native,
            seen.slots,
            seen.halves,
            seen.scale,
            views=views,
            shrink=shrink,
            rim=_native.FrontRim(**asdict(rim)),
            vignetted=options.cats_eye > 0,
            darken=options.darken,
            first=first,
            last=last,
            image=image,
        )

    tiles = -(-maps.height // _native.TILE_ROWS) * -(-maps.width // _native.TILE_COLUMNS)
    map_ranges(work, tiles, execution, label="multiplane: render", chunk=4)
    return image


def shrink_of(shear: Shear, cells: npt.NDArray[np.int32], where: Locations) -> npt.NDArray[np.float64]:
    """Return by how much each plane's views draw together to make up for the blur of its map, (K,).

    Sharing a ray out among cells convolves with a triangle two cells wide, of the variance 1/6 along each
    axis; so does interpolation.
    """
    weight = where.weight[:, None].astype(np.float64)
    of_pixel = float((np.square(where.offset, dtype=np.float64) * weight).sum() / 2)
    of_lens = float((np.square(where.uv, dtype=np.float64) * weight).sum() / 2)
    wanted = of_pixel + np.square(shear.slope) * of_lens
    own = 1 / (3 * np.square(cells, dtype=np.float64)) + np.square(shear.smoothing)
    left: npt.NDArray[np.float64] = np.sqrt(np.maximum(1 - own / np.maximum(wanted, 1e-12), _LEAST_SHARE))
    return left
