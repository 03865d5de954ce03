"""What the methods that work tile by tile share: the tiles, and what each layer of depth shows in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.method import Image, Reconstruction

__all__ = ["Tiling"]


@dataclass(frozen=True, kw_only=True)
class Tiling:
    """An image cut into square tiles, row by row.

    Parameters
    ----------
    height, width : int
        Image size in pixels.
    tile : int
        Side of a tile in pixels.
    """

    height: int
    width: int
    tile: int

    @property
    def tile_columns(self) -> int:
        """Tiles in a row of tiles."""
        return -(-self.width // self.tile)

    @property
    def tile_count(self) -> int:
        """Number of tiles."""
        return self.tile_columns * -(-self.height // self.tile)

    def tile_rectangle(self, tile: int) -> tuple[int, int, int, int]:
        """Row, column, height and width of a tile, cut off at the image's right and bottom edges."""
        row, column = (self.tile * part for part in divmod(tile, self.tile_columns))
        return row, column, min(self.tile, self.height - row), min(self.tile, self.width - column)

    def reconstruction(
        self, image: Image, layer_counts: npt.NDArray[np.int32], layers: npt.NDArray[np.float32] | None
    ) -> Reconstruction:
        """Return an image with its layers' AOVs.

        Parameters
        ----------
        image : ndarray, (H, W, 3)
            Radiance.
        layer_counts : ndarray, (tiles,)
            Active layers of each tile.
        layers : ndarray, (H, W, L, 4), or None
            Radiance and opacity of each layer; None for an image without AOVs.

        Returns
        -------
        Reconstruction
        """
        if layers is None:
            return Reconstruction(image)
        return Reconstruction(
            image,
            {
                "layer_count": self._spread(layer_counts),
                "layer_radiance": layers[..., :3],
                "layer_opacity": layers[..., 3],
            },
        )

    def _spread(self, values: npt.NDArray[np.int32]) -> npt.NDArray[np.float32]:
        """Map, (H, W), of a number of each tile."""
        blocks = values.reshape(-1, self.tile_columns).astype(np.float32)
        return np.kron(blocks, np.ones((self.tile, self.tile), np.float32))[: self.height, : self.width]
