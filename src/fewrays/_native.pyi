"""
Inner loops of fewrays. Internal: shapes and units are described where the calls are made.
"""

import enum
from typing import Annotated

import numpy
from numpy.typing import NDArray


class FilterFamily(enum.Enum):
    paper = 0

    matched = 1

    axis_aligned = 2

class Sampling(enum.Enum):
    disc = 0

    square = 1

    gaussian = 2

class FilterRule:
    def __init__(self, *, family: FilterFamily, sigma_pix: float, sigma_u: float, max_sigma_x: float, occluded_sigma_x: float, sampling: Sampling, sampling_sigma: float, aperture_moment: float, k: float) -> None: ...

def layer_filter(c_min: float, c_max: float, occlusion: float, rule: FilterRule) -> tuple[float, float, float]: ...

def layer_taps(variance: float, ring: int, family: FilterFamily) -> tuple[int, list[float]]: ...

class Samples:
    def __init__(self, xy: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 2), order='C', device='cpu', writable=False)], uv: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 2), order='C', device='cpu', writable=False)], depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], color: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 3), order='C', device='cpu', writable=False)], c0: float, c1: float) -> None: ...

def block_extents(samples: Samples, block: int, margin: float, first: int, last: int, extents: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 4), order='C', device='cpu')]) -> None: ...

class LayeredPlan:
    def __init__(self, tile: int, ring: int, max_layers: int, bins_per_pixel: float, first_bin: int, partition_of_bin: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], slot_of_partition: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], rule: FilterRule) -> None: ...

def layered_tiles(samples: Samples, extents: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 4), order='C', device='cpu', writable=False)], block: int, plan: LayeredPlan, first: int, last: int, image: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order='C', device='cpu')], counts: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu')], layer_images: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 4), order='C', device='cpu')] | None) -> None: ...
