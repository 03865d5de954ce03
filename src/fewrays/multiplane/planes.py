"""`Multiplane`: planes that are made of samples once, and any number of images that are made of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from fewrays.cuda.samples import DeviceSamples
from fewrays.lens import Lens
from fewrays.method import make_options
from fewrays.multiplane import engine
from fewrays.multiplane.build import BuildOptions
from fewrays.multiplane.files import load_maps, save_maps
from fewrays.multiplane.maps import Maps
from fewrays.multiplane.render import RenderOptions
from fewrays.parallel import Execution
from fewrays.samples import SampleBuffer

__all__ = ["Multiplane"]

Options = TypeVar("Options", BuildOptions, RenderOptions)


@dataclass(frozen=True, eq=False)
class Multiplane:
    """Maps of radiance and opacity by depth, made of samples once, for any number of images.

    Building takes most of the time, and rendering an image little: for any focus, aperture and shutter that
    the samples cover. Make one with `Multiplane.build` or `Multiplane.load`.

    Parameters
    ----------
    planes : Maps or DevicePlanes
        The planes from front to back, in the host's memory or in a GPU's.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> pixels = np.stack(np.meshgrid(np.arange(4), np.arange(3)), axis=-1)[:, :, None, :]
    >>> samples = SampleBuffer(
    ...     xy=pixels + rng.random((3, 4, 8, 2)),
    ...     uv=rng.uniform(-0.7, 0.7, (3, 4, 8, 2)),
    ...     depth=np.full((3, 4, 8), 8.0),
    ...     color=np.ones((3, 4, 8, 3)),
    ...     lens=Lens(-10.0, 2.0),
    ... )
    >>> planes = Multiplane.build(samples)
    >>> planes.render(planes.lens.refocus(8.0), views=32).round(3).max()
    np.float32(1.0)
    """

    planes: engine.AnyPlanes

    @classmethod
    def build(cls, samples: SampleBuffer | DeviceSamples, **options: Any) -> Multiplane:
        """Sort samples into planes and estimate each plane's radiance and opacity.

        Parameters
        ----------
        samples : SampleBuffer or DeviceSamples
        **options
            The fields of `fewrays.multiplane.BuildOptions`, and `device`, `threads` and `progress` as for
            `fewrays.reconstruct`. Planes that a GPU makes stay in its memory.

        Returns
        -------
        Multiplane

        Raises
        ------
        SampleError
            For options out of range.
        """
        return cls(engine.build(samples, *split_options(BuildOptions, options, "Multiplane.build")))

    def render(self, lens: Lens | None = None, **options: Any) -> npt.NDArray[np.float32]:
        """Make an image.

        Parameters
        ----------
        lens : Lens, optional
            Focus, lens radius and aperture of the image: that of the samples unless given, or what
            ``planes.lens.refocus(…)`` returns. Through a larger lens than that of the samples, what none of
            them saw is missing: there the planes continue what they know.
        **options
            The fields of `fewrays.multiplane.RenderOptions`, and `device`, `output`, `threads` and `progress`
            as for `fewrays.reconstruct`, but that ``device="auto"`` is where the planes are.

        Returns
        -------
        ndarray of float32, (H, W, 3)
            Radiance.

        Raises
        ------
        SampleError
            For options out of range, or a lens that these planes cannot be seen through.
        """
        return engine.render(self.planes, lens, *split_options(RenderOptions, options, "Multiplane.render"))

    def on_card(self) -> Multiplane:
        """Return the same planes in the memory of the current GPU, which makes many images of them faster.

        Raises
        ------
        SampleError
            Without a GPU.
        """
        return Multiplane(engine.on_card(self.planes))

    def save(self, path: str | Path) -> None:
        """Write one compact file, ``.planes``.

        Raises
        ------
        SampleError
            When the file cannot be written.
        """
        save_maps(path, self.maps)

    @classmethod
    def load(cls, path: str | Path) -> Multiplane:
        """Read what `save` wrote.

        Raises
        ------
        SampleError
            For a file that is missing, of another kind or damaged.
        """
        return cls(load_maps(path))

    @cached_property
    def maps(self) -> Maps:
        """The planes in the host's memory."""
        return engine.on_host(self.planes)

    @property
    def lens(self) -> Lens:
        """The lens of the samples."""
        return self.planes.lens

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self.planes.height

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self.planes.width

    @property
    def nbytes(self) -> int:
        """Bytes that the maps take."""
        return self.planes.nbytes

    def __repr__(self) -> str:
        return (
            f"Multiplane({self.width} x {self.height} pixels, {self.planes.plane_count} planes, "
            f"{self.nbytes / (self.width * self.height):.0f} bytes a pixel)"
        )


def split_options(kind: type[Options], given: dict[str, Any], taker: str) -> tuple[Options, Execution]:
    """Make an options object and an `Execution` out of keyword arguments.

    Raises
    ------
    SampleError
        For a name that neither has, or a value out of range.
    """
    execution = {name: given[name] for name in ("device", "output", "threads", "progress") if name in given}
    own = {name: value for name, value in given.items() if name not in execution}
    return make_options(kind, own, taker), Execution(**{"device": "auto", **execution})
