"""
Inner loops of fewrays. Internal: shapes and units are described where the calls are made.
"""

from collections.abc import Sequence
import enum
from typing import Annotated

import numpy
from numpy.typing import NDArray

class FilterFamily(enum.Enum):
    sheared = 0

    axis_aligned = 1

class Sampling(enum.Enum):
    disc = 0

    square = 1

    gaussian = 2

class FilterRule:
    def __init__(
        self,
        *,
        family: FilterFamily,
        sigma_pix: float,
        sigma_u: float,
        max_sigma_x: float,
        sampling: Sampling,
        sampling_sigma: float,
        k: float,
    ) -> None: ...

def layer_filter(c_min: float, c_max: float, rule: FilterRule) -> tuple[float, float, float]: ...
def layer_taps(variance: float, ring: int) -> list[float]: ...

class Samples:
    def __init__(
        self,
        xy: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None, 2), order="C", device="cpu", writable=False)
        ],
        uv: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None, 2), order="C", device="cpu", writable=False)
        ],
        depth: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
        ],
        color: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None, 3), order="C", device="cpu", writable=False)
        ],
        c0: float,
        c1: float,
    ) -> None: ...

def block_extents(
    samples: Samples,
    block: int,
    margin: float,
    first: int,
    last: int,
    extents: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 4), order="C", device="cpu")],
) -> None: ...

class PublishedPlan:
    def __init__(
        self,
        tile: int,
        ring: int,
        max_layers: int,
        bins_per_pixel: float,
        first_bin: int,
        partition_of_bin: Annotated[
            NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        slot_of_partition: Annotated[
            NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        rule: FilterRule,
    ) -> None: ...

def published_tiles(
    samples: Samples,
    extents: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, 4), order="C", device="cpu", writable=False)
    ],
    block: int,
    plan: PublishedPlan,
    first: int,
    last: int,
    image: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu")],
    counts: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu")],
    layer_images: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None, 4), order="C", device="cpu")
    ]
    | None,
) -> None: ...

class LayeredPlan:
    def __init__(
        self,
        *,
        tile: int,
        boundaries: Annotated[
            NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        levels: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        deepest_tile_level: int,
        reaches: Annotated[
            NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        pixel_variance: float,
        aperture_variance: float,
        part_variance: float,
        parts: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        interpolation: float,
        full_weight: float,
        seen: float,
        finest_by_place: int,
    ) -> None: ...

class BlockLayers:
    def __init__(
        self,
        block: int,
        extents: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, 4), order="C", device="cpu", writable=False)
        ],
        counts: Annotated[
            NDArray[numpy.int32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
        ],
        slope_sums: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
        ],
    ) -> None: ...

class CoarseMap:
    def __init__(
        self,
        layer: int,
        row: int,
        column: int,
        values: Annotated[NDArray[numpy.float32], dict(shape=(5, None, None), order="C", device="cpu")],
    ) -> None: ...

class CoarsePass:
    def __init__(
        self, *, first_level: int, last_level: int, left: int, top: int, right: int, bottom: int, side: int
    ) -> None: ...

def block_layers(
    samples: Samples,
    plan: LayeredPlan,
    margin: float,
    first: int,
    last: int,
    block: int,
    extents: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 4), order="C", device="cpu")],
    counts: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None), order="C", device="cpu")],
    slope_sums: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None: ...
def coarse_tiles(
    samples: Samples,
    blocks: BlockLayers,
    plan: LayeredPlan,
    coarse_pass: CoarsePass,
    maps: Sequence[CoarseMap],
    first: int,
    last: int,
) -> None: ...
def layered_tiles(
    samples: Samples,
    blocks: BlockLayers,
    plan: LayeredPlan,
    maps: Sequence[CoarseMap],
    tiles: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    image: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu")],
    counts: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu")],
    contributions: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None, 4), order="C", device="cpu")
    ]
    | None,
) -> None: ...

class LightField:
    def __init__(
        self,
        *,
        xy: Annotated[NDArray[numpy.float32], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
        uv: Annotated[NDArray[numpy.float32], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
        depth: Annotated[
            NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        color: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        time: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)]
        | None,
        motion: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ]
        | None,
        bandwidth: Annotated[
            NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
        ]
        | None,
        spacing: Annotated[
            NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
        ]
        | None,
        c0: float,
        c1: float,
    ) -> None: ...

class TreeRule:
    def __init__(
        self,
        *,
        bin: float,
        most_samples: int,
        along_lens: float,
        along_time: float,
        tolerance: float,
        left: float,
        right: float,
        top: float,
        bottom: float,
    ) -> None: ...

class SampleTree:
    def __init__(self, field: LightField, rule: TreeRule) -> None: ...
    @property
    def leaf_count(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def node_count(self) -> int: ...
    def write_depth_first(
        self,
        nodes: Annotated[NDArray[numpy.int32], dict(shape=(None, 18), order="C", device="cpu")],
        order: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu")],
    ) -> None: ...
    def query(self, x: float, y: float, u: float, v: float, time: float, radius: float) -> list[int]: ...

class SurfaceRule:
    def __init__(
        self,
        *,
        radius: float,
        along_lens: float,
        along_time: float,
        tolerance: float,
        tent: float,
        overhang: float,
    ) -> None: ...

def temporal_locations(
    tree: SampleTree,
    rule: SurfaceRule,
    locations: Annotated[
        NDArray[numpy.float32], dict(shape=(None, 5), order="C", device="cpu", writable=False)
    ],
    colors: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
    found: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
) -> tuple[int, int, int, int, int, int, int, int, int]: ...

class Lights:
    def __init__(
        self,
        *,
        projection: Annotated[
            NDArray[numpy.float32], dict(shape=(4), order="C", device="cpu", writable=False)
        ],
        rule: SurfaceRule,
        unlit: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        normal: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        facing: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
    ) -> None: ...
    def add(
        self,
        *,
        tree: SampleTree,
        reflectance: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        arrives: Annotated[
            NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        points: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 2), order="C", device="cpu", writable=False)
        ],
        frame: Annotated[NDArray[numpy.float32], dict(shape=(4, 3), order="C", device="cpu", writable=False)],
        half_size: Annotated[
            NDArray[numpy.float32], dict(shape=(2), order="C", device="cpu", writable=False)
        ],
        distance: float,
        motion: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
        radiance: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)]
        | None,
        area: float,
    ) -> None: ...

def shade_tiles(
    field: LightField,
    lights: Lights,
    tile: int,
    share: int,
    times: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    first_view: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    first: int,
    last: int,
    radiance: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 3), order="C", device="cpu")],
) -> None: ...
def settle_rows(
    xy: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None, 2), order="C", device="cpu", writable=False)
    ],
    at_center: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None, 2), order="C", device="cpu", writable=False)
    ],
    inverse_depth: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
    ],
    inverse_gradient: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None, 2), order="C", device="cpu", writable=False)
    ],
    normal: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None, 3), order="C", device="cpu", writable=False)
    ],
    light: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
    ],
    difference: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
    ],
    sigma: float,
    pixel: float,
    first: int,
    last: int,
    share: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
    variance: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None: ...
def temporal_tiles(
    tree: SampleTree,
    rule: SurfaceRule,
    views: Annotated[NDArray[numpy.float32], dict(shape=(None, 6), order="C", device="cpu", writable=False)],
    tile: int,
    band_starts: Annotated[
        NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
    ],
    lights: Lights | None,
    first: int,
    last: int,
    bands: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 4), order="C", device="cpu")],
) -> tuple[int, int, int, int, int, int, int, int, int]: ...
def dynamic_halve(
    fine: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 8), order="C", device="cpu")],
    coarse: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 8), order="C", device="cpu")],
    first: int,
    last: int,
) -> None: ...
def dynamic_mipmap(
    levels: Sequence[Annotated[NDArray[numpy.float32], dict(shape=(None, None, 8), order="C", device="cpu")]],
    view_radius: float,
    first: int,
    last: int,
) -> None: ...

class BlurRule:
    def __init__(self, *, radius: float, tolerance: float, relative: float, level: int) -> None: ...

def dynamic_blur_along(
    level: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 8), order="C", device="cpu")],
    passed: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 8), order="C", device="cpu")],
    rule: BlurRule,
    first: int,
    last: int,
) -> None: ...
def dynamic_blur_down(
    passed: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 8), order="C", device="cpu")],
    level: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 8), order="C", device="cpu")],
    sheet: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 8), order="C", device="cpu")],
    rule: BlurRule,
    first: int,
    last: int,
) -> None: ...
def dynamic_background(
    light: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, 4), order="C", device="cpu", writable=False)
    ],
    slope: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)
    ],
    front: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)
    ],
    edge: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    needed: Annotated[
        NDArray[numpy.uint8], dict(shape=(None, None), order="C", device="cpu", writable=False)
    ],
    most: float,
    tolerance: float,
    agreement: float,
    reach: int,
    first: int,
    last: int,
    background: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 6), order="C", device="cpu")],
) -> None: ...

class FrontRim:
    def __init__(
        self, *, centre_x: float, centre_y: float, per_pixel: float, radius: float, softness: float
    ) -> None: ...

class Sheets:
    def __init__(
        self,
        texels: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None, 8), order="C", device="cpu", writable=False)
        ],
        pixels: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None, 2), order="C", device="cpu", writable=False)
        ],
        behind: Annotated[
            NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
    ) -> None: ...

def dynamic_blocks(
    sheets: Sheets,
    block: int,
    first: int,
    last: int,
    blocks: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 4), order="C", device="cpu")],
) -> None: ...
def dynamic_tiles(
    sheets: Sheets,
    blocks: Annotated[
        NDArray[numpy.float32], dict(shape=(None, None, None, 4), order="C", device="cpu", writable=False)
    ],
    block: int,
    tile: int,
    views: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    tolerance: float,
    growth: int,
    rim: FrontRim | None,
    first: int,
    last: int,
    sums: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 5), order="C", device="cpu")],
    passed: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")] | None,
) -> tuple[float, float]: ...

BLOCK_ROWS: int = 8

BLOCK_COLUMNS: int = 32

TILE_ROWS: int = 16

TILE_COLUMNS: int = 128

UNIT_HALVES: int = 1188

HALF_PADDING: int = 64

class DepthPlanes:
    def __init__(
        self,
        shears: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 4), order="C", device="cpu", writable=False)
        ],
        grids: Annotated[
            NDArray[numpy.int32], dict(shape=(None, 6), order="C", device="cpu", writable=False)
        ],
        most_blur: float,
    ) -> None: ...

def multiplane_mark(
    field: LightField,
    plane_of: Annotated[NDArray[numpy.int16], dict(shape=(None,), order="C", device="cpu", writable=False)],
    planes: DepthPlanes,
    marks: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu")],
    reach: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    brightest: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
) -> None: ...
def multiplane_runs(
    field: LightField,
    plane_of: Annotated[NDArray[numpy.int16], dict(shape=(None,), order="C", device="cpu", writable=False)],
    length: int,
    first: int,
    last: int,
    runs: SampleRuns,
) -> None: ...

class SampleRuns:
    def __init__(self, count: int) -> None: ...

def multiplane_build(
    field: LightField,
    plane_of: Annotated[NDArray[numpy.int16], dict(shape=(None,), order="C", device="cpu", writable=False)],
    planes: DepthPlanes,
    slots: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    runs: SampleRuns,
    run_length: int,
    reach: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    prior: float,
    along: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    parts: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    first: int,
    last: int,
    halves: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order="C", device="cpu")],
) -> None: ...
def multiplane_smooth(
    planes: DepthPlanes,
    slots: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    halves: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order="C", device="cpu", writable=False)],
    sigma: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    copies: DepthPlanes,
    is_halved: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu", writable=False)],
    places: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu")],
    parts: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    first: int,
    last: int,
    smoothed: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order="C", device="cpu")],
) -> None: ...
def multiplane_render(
    planes: DepthPlanes,
    slots: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    built: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order="C", device="cpu", writable=False)],
    smoothed: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order="C", device="cpu", writable=False)],
    is_smoothed: Annotated[
        NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu", writable=False)
    ],
    is_halved: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order="C", device="cpu", writable=False)],
    *,
    views: Annotated[NDArray[numpy.float32], dict(shape=(None, 6), order="C", device="cpu", writable=False)],
    shrink: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    reach: Annotated[NDArray[numpy.float32], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    rim: FrontRim,
    vignetted: bool,
    darken: bool,
    first: int,
    last: int,
    image: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 4), order="C", device="cpu")],
) -> None: ...
