"""Images of other methods, kept between runs: who tunes one method need not wait for its slowest rival."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import fewrays
from fewrays.method import Image

__all__ = ["KeptImages"]


@dataclass(frozen=True)
class KeptImages:
    """A folder of images; without one nothing is kept.

    Parameters
    ----------
    folder : path, optional
        Made when it does not exist. Empty it when a method in it has changed: what is there is believed.
    """

    folder: Path | None = None

    def image(self, name: str, source: Path, make: Callable[[], Image]) -> Image:
        """Return an image of samples, made anew unless it is there and newer than the samples.

        Parameters
        ----------
        name : str
            The method, as a part of the file's name.
        source : path
            The samples' file.
        make : callable
            Makes the image ``(H, W, 3)``.
        """
        if self.folder is None:
            return make()
        path = self.folder / f"{source.stem}_{name.replace(' ', '-').lower()}.npy"
        if path.exists() and path.stat().st_mtime > source.stat().st_mtime:
            return fewrays.load_image(path)
        self.folder.mkdir(parents=True, exist_ok=True)
        image = make()
        fewrays.save_image(path, image)
        return image
