"""The aperture among a method's options: the lens's own, a polygon of blades, or an image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from fewrays.aperture import Aperture, ApertureImage
from fewrays.errors import SampleError
from fewrays.io import load_image
from fewrays.lens import Lens

__all__ = ["ApertureOptions", "load_aperture_image"]

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of linear Rec. 709 primaries


@dataclass(frozen=True, kw_only=True)
class ApertureOptions:
    """Options of methods that integrate over any aperture."""

    blades: int = 0
    """Blades of the aperture, 3 to 64: the corners of its polygon; 0 for that of the samples' lens."""
    rotation: float = 0.0
    """Direction of the polygon's first corner, in degrees."""
    roundness: float = 0.0
    """Curvature of the polygon's sides: 0 for straight ones, 1 for those of a disc."""
    aperture_image: Path | None = None
    """Picture of the aperture instead: white lets light pass. It fills the square around the lens."""
    squeeze: float = 1.0
    """How many times as tall as wide the aperture becomes: 2 for the ellipses of a 2x anamorphic lens."""

    def __post_init__(self) -> None:
        self.aperture_of(Lens(-1.0, 1.0))

    def aperture_of(self, lens: Lens) -> Aperture:
        """Return the aperture to integrate over.

        Raises
        ------
        SampleError
            For options out of range, blades as well as an image, or an image that cannot be used.
        """
        if self.aperture_image is not None:
            if self.blades:
                raise SampleError(
                    f"is given beside {self.blades} blades; give one of the two", field="aperture_image"
                )
            aperture = Aperture("image", image=self._loaded_image)
        elif self.blades:
            aperture = Aperture("polygon", lens.sigma, self.blades, self.rotation, self.roundness)
        else:
            aperture = Aperture.of_lens(lens)
        return replace(aperture, squeeze=self.squeeze)

    @cached_property
    def _loaded_image(self) -> ApertureImage:
        """The image, loaded when the options are made and not again."""
        assert self.aperture_image is not None
        return load_aperture_image(self.aperture_image)


def load_aperture_image(path: str | Path) -> ApertureImage:
    """Read an aperture image, of any format and size that `fewrays.load_image` reads.

    Parameters
    ----------
    path : str or path
        What is open is white. Colours count by their luminance, a PNG's after decoding to linear light. A
        picture that is not square is stretched to the lens square.

    Raises
    ------
    SampleError
        For a file that cannot be read, or that is negative somewhere or black everywhere; it names the file.
    """
    image = load_image(path)
    try:
        return ApertureImage(image if image.ndim == 2 else image @ _LUMINANCE)
    except SampleError as error:
        raise error.in_file(path) from None
