"""`Machine`: what kernels run on.

The methods say which kernels run one after the other, on which arrays, and know no more of the card than
this. So the same steps run in tests on a machine that is none: there arrays are NumPy's, and the phases of
kernels are compiled for the CPU.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from fewrays.cuda.kernel import Kernel

__all__ = ["Machine", "blocks_for"]


class Machine(Protocol):
    """Where arrays are and kernels run, in the order of their launches."""

    @property
    def xp(self) -> Any:
        """The module of its arrays, CuPy or NumPy."""

    @property
    def cache_bytes(self) -> int:
        """Size of the cache that all multiprocessors share, in bytes."""

    @property
    def shared_bytes(self) -> int:
        """Shared memory that a block of threads can have, in bytes."""

    def launch(
        self, kernel: Kernel, grid: tuple[int, int, int], *, shared_bytes: int = 0, **arguments: Any
    ) -> None:
        """Start a kernel.

        Parameters
        ----------
        kernel : Kernel
        grid : (int, int, int)
            Blocks along x, y and z, the last two at most 65535; with none in all, nothing starts.
        shared_bytes : int
            Shared memory of each block besides what the kernel declares itself.
        **arguments
            Its fields, by name.
        """

    def address(self, array: Any) -> int:
        """Return where an array begins, as kernels see it."""

    def on_device(self, array: Any, dtype: Any) -> Any:
        """Return an array that kernels can read, contiguous and of that type; itself if it is so already."""

    def on_host(self, array: Any) -> Any:
        """Return a NumPy array; waits for what makes it."""

    def fetch(self, array: Any) -> Callable[[], Any]:
        """Begin to copy an array to the host, and return what waits for that and gives the NumPy array.

        It waits for nothing that is started in between. The array is to be small and not to be changed.
        """


def blocks_for(count: int, kernel: Kernel) -> int:
    """Return the blocks that give each of `count` things a thread."""
    return -(-count // kernel.threads)
