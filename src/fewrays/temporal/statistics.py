"""How often each case of temporal's section 3.3 occurred."""

from __future__ import annotations

from dataclasses import astuple, dataclass

__all__ = ["Statistics"]


@dataclass(frozen=True)
class Statistics:
    """Counts over the reconstruction locations of an image.

    Parameters
    ----------
    locations : int
        All of them.
    empty : int
        Those that found no sample.
    single : int
        One surface within R: the first early-out.
    quadrants : int
        A front surface that fills all four quadrants within R: the second.
    covered : int
        A surface that a triangle of its samples shows to cover the location.
    last : int
        The last surface, which needs no proof.
    wide : int
        Locations that looked beyond R.
    surfaces : int
        Surfaces looked at, in all; those behind the one that was chosen are not counted.
    merged : int
        Surfaces of too few samples, blended with the next.
    """

    locations: int = 0
    empty: int = 0
    single: int = 0
    quadrants: int = 0
    covered: int = 0
    last: int = 0
    wide: int = 0
    surfaces: int = 0
    merged: int = 0

    def __add__(self, other: Statistics) -> Statistics:
        """Add up two sets of locations."""
        return Statistics(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def describe(self) -> str:
        """Shares of the locations, in words."""
        total = max(self.locations, 1)
        return (
            f"{self.surfaces / total:.2f} surfaces per location; "
            f"{(self.single + self.quadrants) / total:.1%} early-outs "
            f"({self.single / total:.1%} one surface, {self.quadrants / total:.1%} all quadrants), "
            f"{self.covered / total:.1%} by a triangle, "
            f"{self.last / total:.1%} the last surface, {self.empty / total:.1%} empty; "
            f"{self.wide / total:.1%} looked beyond R, {self.merged / total:.1%} merged"
        )
