"""``fewrays compare``: how far an image is from its reference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from fewrays.cli.command import Command, check_output
from fewrays.io import load_image
from fewrays.metrics import compare

__all__ = ["Compare"]


@dataclass(frozen=True)
class Compare(Command):
    """Measure an image against its reference: PSNR, relMSE, SSIM, FLIP.

    Both images have the same size. SSIM and FLIP need the 'metrics' extra.

    Parameters
    ----------
    image
        The image to judge: .exr, .png or .npy.
    reference
        What it should be: .exr, .png or .npy.
    heatmap
        Also write a picture of where the errors are (.png).
    """

    examples: ClassVar[tuple[str, ...]] = (
        "fewrays compare out.exr reference.exr",
        "fewrays compare out.exr reference.exr --heatmap errors.png",
    )

    image: Annotated[Positional[Path], arg(metavar="IMAGE")]
    reference: Annotated[Positional[Path], arg(metavar="REFERENCE")]
    heatmap: Path | None = None

    def run(self) -> None:
        """Print the table, and write the heat map when asked."""
        if self.heatmap is not None:
            check_output(self.heatmap, [".png"])
        image, reference = load_image(self.image), load_image(self.reference)
        print(compare(image, reference))
        if self.heatmap is not None:
            from fewrays.display import save_picture
            from fewrays.metrics import error_heatmap

            save_picture(self.heatmap, error_heatmap(image, reference))
            print(f"wrote {self.heatmap}")
