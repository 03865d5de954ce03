"""The temporal method's native engines against its reference, each other, and what must not change them."""

from __future__ import annotations

from dataclasses import astuple, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.method import Image
from fewrays.parallel import Execution
from fewrays.samples import OFF_IMAGE
from fewrays.temporal import TemporalOptions, kernel, make_plan, reference
from fewrays.temporal.hierarchy import Hierarchy
from fewrays.temporal.locations import Locations
from fewrays.temporal.plan import Plan, SurfaceRule
from fewrays.temporal.statistics import Statistics

Float32 = npt.NDArray[np.float32]

KINDS = ("still", "moving", "approaching", "glossy", "approaching, glossy")


def lens_of(blur: float) -> Lens:
    """Return a lens focused at 5 that gives the far background a circle of confusion of `blur` pixels."""
    return Lens(-5 * blur, blur)


def make_samples(kind: str, height: int, width: int, spp: int, blur: float, seed: int = 0) -> SampleBuffer:
    """Samples of random surfaces; each moves in its own direction, and approaching ones in depth as well."""
    samples = random_buffer(height, width, spp, lens_of(blur), seed=seed, off_image=0.05)
    shape = samples.depth.shape
    rng = np.random.default_rng(seed + 1)
    if "moving" in kind or "approaching" in kind:
        # Surfaces are those of like depth, of which there are a few.
        surface = np.unique(np.round(np.log(samples.depth) * 5), return_inverse=True)[1].reshape(shape)
        velocity = rng.normal(0.0, 12.0, (int(surface.max()) + 1, 3)) * rng.integers(0, 2)
        velocity[:, 2] = rng.uniform(-1.2, 1.2, len(velocity)) if "approaching" in kind else 0.0
        motion = (velocity[surface] + rng.normal(0.0, 0.1, (*shape, 3))) * samples.depth[..., None]
        if "approaching" not in kind:
            motion[..., 2] = 0.0
        samples = replace(samples, time=rng.random(shape, np.float32), motion=motion.astype(np.float32))
    if "glossy" in kind:
        bandwidth = np.where(rng.random(shape) < 0.3, np.inf, rng.uniform(0.02, 1.0, shape))
        samples = replace(samples, bandwidth=bandwidth.astype(np.float32))
    return samples


def run_bands(
    samples: SampleBuffer,
    engine: str = "cpu",
    *,
    plan: Plan | None = None,
    threads: int = 1,
    **options: Any,
) -> tuple[Float32, Statistics]:
    """Sums of radiance and weight, (H, W, bands, 4), over 16 locations, unless told otherwise."""
    plan = plan or make_plan(samples, TemporalOptions(**{"locations": 16, **options}))
    bands = np.zeros((samples.height, samples.width, len(plan.band_starts), 4), np.float32)
    tiles = {"cpu": kernel, "reference": reference}[engine].reconstruct_tiles
    return bands, tiles(samples, plan, bands, Execution(threads=threads))


def run(samples: SampleBuffer, engine: str = "cpu", **options: Any) -> tuple[Image, Statistics]:
    """Mean over the locations, whatever their blur."""
    bands, counts = run_bands(samples, engine, **options)
    sums = bands.sum(axis=2)
    weight = sums[..., 3:]
    return np.divide(sums[..., :3], weight, out=np.zeros_like(sums[..., :3]), where=weight > 0), counts


def assert_twins(actual: npt.ArrayLike, expected: npt.ArrayLike) -> None:
    """Assert equality to rounding.

    Samples at the rim of a radius and paths that cross by just the tolerance are the exceptions: at one
    location of a pixel they may turn one surface into another.
    """
    assert_agree(actual, expected, tolerance=1e-4, flips=0.02, jump=1.0)


def assert_like(actual: Statistics, expected: Statistics) -> None:
    """Assert that counts differ by what few flips explain."""
    assert actual.locations == expected.locations
    np.testing.assert_allclose(astuple(actual), astuple(expected), rtol=0.002, atol=3)


def only(plan: Plan, number: int) -> Plan:
    """Return a plan with one of its locations, which then is all that a pixel's value comes from."""
    each = slice(number, number + 1)
    where = plan.locations
    one = Locations(where.uv[each], where.t[each], where.offset[each], np.ones(1, np.float32))
    return replace(plan, locations=one)


class TestAgainstTheReference:
    @pytest.mark.parametrize("blur", [0.5, 8.0, 80.0])
    @pytest.mark.parametrize("kind", KINDS)
    def test_images_and_statistics_agree(self, kind: str, blur: float) -> None:
        samples = make_samples(kind, 9, 12, 4, blur)
        expected, counts = run_bands(samples, "reference", locations=4)
        actual, native_counts = run_bands(samples, locations=4)
        assert_twins(actual.sum(axis=2), expected.sum(axis=2))
        assert_twins(actual, expected)
        assert_like(native_counts, counts)

    @pytest.mark.parametrize(
        "options",
        [
            {"tent_scale": 0.0},
            {"tent_scale": 0.0},
            {"tent_scale": 0.3},
            {"tent_scale": 2.0},
            {"radius_scale": 0.25},
            {"radius_scale": 0.6},
            {"pixel_filter": "mitchell"},
            {"pixel_filter": "gaussian", "sigma_pix": 1.5},
            {"blades": 5},
            {"shutter": (0.2, 0.4), "shutter_response": "triangle"},
            {"shutter": (1.0, 1.0)},
        ],
        ids=lambda options: ",".join(f"{name}={value}" for name, value in options.items()),
    )
    def test_options(self, options: dict[str, Any]) -> None:
        samples = make_samples("approaching, glossy", 9, 12, 3, 3.0, seed=3)
        expected, counts = run(samples, "reference", locations=4, **options)
        actual, native_counts = run(samples, locations=4, **options)
        assert_twins(actual, expected)
        assert_like(native_counts, counts)

    def test_the_whole_method_on_either_device(self) -> None:
        samples = make_samples("approaching", 10, 12, 3, 4.0)
        expected = reconstruct(samples, "temporal", device="reference", locations=6)
        assert_twins(reconstruct(samples, "temporal", device="cpu", locations=6), expected)

    def test_those_buffers_meet_every_case(self) -> None:
        buffers = [make_samples(kind, 9, 12, 4, blur) for kind in KINDS for blur in (0.5, 8.0, 80.0)]
        counts = sum((run(samples, locations=4)[1] for samples in buffers), Statistics())
        counts += run(make_samples("still", 9, 12, 3, 0.5), locations=4, radius_scale=0.25)[1]
        for case in ("single", "quadrants", "covered", "last", "wide", "merged"):
            assert getattr(counts, case) > 0.005 * counts.locations, case

    @pytest.mark.parametrize("tent_scale", [0.0, 0.8, 2.0])
    def test_few_samples_far_apart(self, tent_scale: float) -> None:
        """Some locations look 2, 4 and 8 R far, and some find nothing."""
        samples = make_samples("moving", 16, 40, 1, 0.5, seed=1)
        kept = np.random.default_rng(0).random(samples.depth.shape) < 0.01
        kept[:, 25:] = False
        samples = replace(samples, xy=np.where(kept[..., None], samples.xy, np.float32(OFF_IMAGE)))
        options: dict[str, Any] = {"locations": 2, "radius_scale": 0.4, "tent_scale": tent_scale}
        expected, counts = run(samples, "reference", **options)
        actual, native_counts = run(samples, **options)
        assert_agree(actual, expected, tolerance=1e-5)
        assert native_counts == counts
        assert 0 < counts.empty < counts.wide
        assert len(np.unique(expected.reshape(-1, 3), axis=0)) > kept.sum()

    @settings(max_examples=25)
    @given(
        height=st.integers(1, 8),
        width=st.integers(1, 8),
        spp=st.integers(1, 5),
        kind=st.sampled_from(KINDS),
        blur=st.sampled_from([0.0, 0.3, 3.0, 30.0, 300.0]),
        locations=st.integers(1, 9),
        radius_scale=st.sampled_from([0.3, 1.0, 1.6]),
        tent_scale=st.sampled_from([0.0, 0.25, 0.8, 2.0]),
        seed=st.integers(0, 1000),
    )
    def test_any_buffer(
        self,
        height: int,
        width: int,
        spp: int,
        kind: str,
        blur: float,
        locations: int,
        radius_scale: float,
        tent_scale: float,
        seed: int,
    ) -> None:
        samples = make_samples(kind, height, width, spp, blur, seed)
        options: dict[str, Any] = {
            "locations": locations,
            "radius_scale": radius_scale,
            "tent_scale": tent_scale,
        }
        expected, _ = run(samples, "reference", **options)
        actual, _ = run(samples, **options)
        # One flip is a large share of a tiny image: shares are bounded above.
        assert_agree(actual, expected, tolerance=2e-4, flips=0.2 if height * width > 9 else 1.0)
        assert np.median(np.abs(actual - expected)) <= 1e-4

    def test_samples_that_come_to_the_camera(self) -> None:
        samples = make_samples("approaching", 10, 12, 3, 2.0, seed=5)
        assert samples.motion is not None
        motion = samples.motion.copy()
        motion[::2, ..., 2] = -2.5 * samples.depth[::2]
        samples = replace(samples, motion=motion)
        expected, counts = run(samples, "reference", locations=6)
        actual, native_counts = run(samples, locations=6)
        assert_twins(actual, expected)
        assert_like(native_counts, counts)


class TestSingleLocations:
    """The engine for incoherent locations finds at each what the view-coherent one does."""

    @pytest.mark.parametrize("kind", KINDS)
    @pytest.mark.parametrize("blur", [0.5, 8.0])
    def test_every_location_of_an_image(self, kind: str, blur: float) -> None:
        samples = make_samples(kind, 12, 15, 2, blur)
        plan = replace(make_plan(samples, TemporalOptions(locations=4)), tile=8)
        where = plan.locations
        hierarchy = Hierarchy(samples, plan.rule)
        counts, image, by_views = Statistics(), np.zeros((12, 15, 3)), Statistics()
        for k in range(where.count):
            # Rounded as by the other engine, which counts from a tile's corner.
            corners = (np.arange(15) // plan.tile * plan.tile).astype(np.float32)
            x, y = corners + np.float32(0.5) + where.offset[k][:, None] + np.arange(15) % plan.tile
            places = np.stack(np.meshgrid(x, y[:12]), axis=-1).reshape(-1, 2)
            view = np.append(where.uv[k], where.t[k])
            locations = np.column_stack([places, np.broadcast_to(view, (len(places), 3))])
            color, found, some = kernel.reconstruct_locations(
                hierarchy, plan.rule, locations.astype(np.float32)
            )
            assert found.all()
            counts += some
            tiles, in_view = run(samples, plan=only(plan, k))
            by_views += in_view
            assert_agree(color.reshape(12, 15, 3), tiles, tolerance=1e-4, flips=0.002)
            image += color.reshape(12, 15, 3) / where.count
        actual, in_all = run(samples, plan=plan)
        assert_twins(actual, image)
        assert in_all == by_views
        assert_like(counts, in_all)

    def test_what_is_not_found(self) -> None:
        samples = make_samples("still", 4, 4, 2, 1.0)
        plan = make_plan(samples, TemporalOptions())
        places = np.array([[2, 2, 0, 0, 0], [500, 2, 0, 0, 0]], np.float32)
        color, found, counts = kernel.reconstruct_locations(Hierarchy(samples, plan.rule), plan.rule, places)
        np.testing.assert_array_equal(found, [True, False])
        assert color[0].any()
        assert not color[1].any()
        assert (counts.locations, counts.empty) == (2, 1)


class TestStatistics:
    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    def test_counts_add_up(self, engine: str) -> None:
        samples = make_samples("approaching", 10, 13, 3, 4.0)
        _, counts = run(samples, engine, locations=7)
        assert counts.locations == 10 * 13 * 7
        resolved = counts.single + counts.quadrants + counts.covered + counts.last + counts.empty
        assert resolved == counts.locations
        assert counts.last + counts.empty <= counts.wide <= counts.covered + counts.last + counts.empty
        assert counts.surfaces - counts.merged >= counts.locations - counts.empty

    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    def test_all_is_empty_where_there_is_nothing(self, engine: str) -> None:
        samples = make_samples("still", 3, 4, 1, 2.0)
        image, counts = run(replace(samples, xy=np.full_like(samples.xy, OFF_IMAGE)), engine)
        assert not image.any()
        everything = 3 * 4 * 16
        assert counts == Statistics(locations=everything, empty=everything, wide=everything)


class TestInvariance:
    def test_threads_do_not_change_a_bit(self) -> None:
        samples = make_samples("approaching, glossy", 30, 34, 2, 6.0)
        plan = replace(make_plan(samples, TemporalOptions(locations=4)), tile=5)
        (one, counts), *others = (run_bands(samples, threads=threads, plan=plan) for threads in (1, 2, 3))
        for image, other_counts in others:
            np.testing.assert_array_equal(image, one)
            assert other_counts == counts

    @pytest.mark.parametrize("kind", KINDS)
    def test_order_of_samples_within_a_pixel(self, kind: str) -> None:
        samples = make_samples(kind, 20, 26, 4, 6.0)
        order = np.random.default_rng(5).permuted(np.broadcast_to(np.arange(4), samples.depth.shape), axis=2)
        shuffled = reordered(samples, order)
        assert not np.array_equal(shuffled.depth, samples.depth)
        expected, actual = (run_bands(each, locations=8)[0] for each in (samples, shuffled))
        assert_agree(actual, expected, tolerance=2e-5)

    def test_order_of_samples_where_bands_of_blur_meet(self) -> None:
        """A surface belongs to the band of its least slope, whichever sample comes first."""
        samples = make_samples("still", 16, 18, 4, 8.0)
        rng = np.random.default_rng(0)
        front = rng.random(samples.depth.shape) < 0.5
        slope = np.where(front, rng.uniform(3.6, 4.4, front.shape), 7.9)
        depth = samples.lens.c0 / (slope - samples.lens.c1)
        samples = replace(samples, depth=depth.astype(np.float32))
        turned = reordered(samples, np.broadcast_to(np.arange(4)[::-1], front.shape))
        bands, _ = run_bands(samples)
        assert_agree(run_bands(turned)[0], bands, tolerance=2e-5)
        assert_agree(run_bands(samples, "reference")[0], bands, tolerance=1e-4, flips=0.03)
        assert (bands[..., :2, 3] > 0).any(axis=(0, 1)).all()

    @pytest.mark.parametrize("kind", ["still", "approaching, glossy"])
    def test_size_of_tiles(self, kind: str) -> None:
        """Tiles show nowhere: only the grid's cells, and so the order of sums, depend on them."""
        samples = make_samples(kind, 22, 25, 2, 6.0)
        plan = make_plan(samples, TemporalOptions(locations=4))
        image, counts = run(samples, plan=plan)
        for tile in (4, 11, 128):
            other, other_counts = run(samples, plan=replace(plan, tile=tile))
            assert_agree(other, image, tolerance=2e-5, flips=0.001)
            assert_like(other_counts, counts)

    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    def test_a_motion_of_zeros_changes_nothing(self, engine: str) -> None:
        still = make_samples("still", 9, 11, 3, 6.0)
        time = np.random.default_rng(0).random(still.depth.shape, np.float32)
        zero = replace(still, time=time, motion=np.zeros((*still.depth.shape, 3), np.float32))
        np.testing.assert_array_equal(run(zero, engine)[0], run(still, engine)[0])

    def test_next_to_no_motion_changes_next_to_nothing(self) -> None:
        """Although other code sees to it."""
        still = make_samples("still", 30, 40, 3, 6.0)
        time = np.random.default_rng(0).random(still.depth.shape, np.float32)
        slow = replace(still, time=time, motion=np.full((*still.depth.shape, 3), 1e-20, np.float32))
        assert_agree(run(slow)[0], run(still)[0], tolerance=2e-5, flips=0.002)

    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    def test_matte_samples_may_say_so(self, engine: str) -> None:
        matte = make_samples("moving", 9, 11, 3, 6.0)
        wide = replace(matte, bandwidth=np.full_like(matte.depth, np.inf))
        np.testing.assert_allclose(run(wide, engine)[0], run(matte, engine)[0], rtol=1e-6)

    def test_dropped_samples_leave_no_trace(self) -> None:
        samples = make_samples("approaching", 20, 24, 4, 4.0)
        color = samples.color.copy()
        color[::3, ::2, 1] = np.nan
        with pytest.warns(UserWarning, match="dropped"):
            dropped = SampleBuffer(
                samples.xy,
                samples.uv,
                samples.depth,
                color,
                samples.lens,
                samples.time,
                samples.motion,
                nan="drop",
            )
        without = make_without(samples, np.s_[::3, ::2, 1])
        plan = make_plan(samples, TemporalOptions(locations=8))
        assert_agree(run(dropped, plan=plan)[0], run(without, plan=plan)[0], tolerance=2e-5)

    def test_guard_band_is_used(self) -> None:
        """Samples outside the image reach it: with a guard band it equals the crop of a larger image."""
        large = make_samples("approaching", 40, 40, 2, 3.0)
        plan = make_plan(large, TemporalOptions(locations=4))
        inner = run(large, plan=plan)[0][15:25, 15:25]
        assert large.motion is not None
        motion = large.motion - 15 * large.motion[..., 2:] * (1, 1, 0)
        cropped = replace(large, xy=large.xy - 15, motion=motion)
        image, _ = run(cropped, plan=plan)
        # Positions, and with them what rounding does to them, are others.
        assert_agree(image[:10, :10], inner, tolerance=1e-3, flips=0.01)


def reordered(samples: SampleBuffer, order: npt.NDArray[np.intp]) -> SampleBuffer:
    """Take each pixel's samples in another order, (H, W, S)."""
    fields: dict[str, Any] = {}
    for name in samples.field_names():
        array = getattr(samples, name)
        fields[name] = np.take_along_axis(array, order.reshape(order.shape + (1,) * (array.ndim - 3)), 2)
    return replace(samples, **fields)


def make_without(samples: SampleBuffer, where: tuple[slice, slice, int]) -> SampleBuffer:
    """Move samples out of everyone's reach."""
    xy = samples.xy.copy()
    xy[where] = 1e6
    return replace(samples, xy=xy)


class TestSimpleScenes:
    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    @pytest.mark.parametrize("kind", KINDS)
    def test_a_constant_stays_constant(self, kind: str, engine: str) -> None:
        samples = make_samples(kind, 8, 11, 3, 6.0)
        samples = replace(samples, color=np.broadcast_to([0.75, 0.5, 20.0], samples.color.shape))
        image, _ = run(samples, engine, locations=5, pixel_filter="mitchell")
        np.testing.assert_allclose(image, np.broadcast_to([0.75, 0.5, 20.0], image.shape), rtol=1e-5)

    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    def test_without_an_aperture_lens_points_do_not_matter(self, engine: str) -> None:
        """All slopes are 0, so that there is one surface."""
        samples = make_samples("still", 9, 12, 3, 8.0).refocus(aperture_scale=0.0)
        bands, counts = run_bands(samples, engine)
        elsewhere, _ = run_bands(replace(samples, uv=-0.5 * samples.uv), engine)
        np.testing.assert_array_equal(bands, elsewhere)
        np.testing.assert_allclose(bands[..., 0, 3], 1.0, rtol=1e-6)
        assert not bands[:, :, 1:].any()
        assert counts.single + counts.last == counts.locations
        assert counts.surfaces == counts.locations

    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    def test_a_plane_is_one_surface_filtered_by_the_tent(self, engine: str) -> None:
        """The mean, over a pixel's locations, of tents over all samples where they are seen from."""
        samples = make_samples("still", 12, 14, 4, 8.0)
        samples = replace(samples, depth=np.full_like(samples.depth, 9.0))
        plan = make_plan(samples, TemporalOptions(locations=8, tent_scale=0.8))
        image, counts = run(samples, engine, plan=plan)
        assert counts.single + counts.last == counts.surfaces == counts.locations
        xy, uv = (values.reshape(-1, 2).astype(np.float64) for values in (samples.xy, samples.uv))
        color, slope = samples.color.reshape(-1, 3), float(samples.lens.slope(9.0))
        expected = np.zeros((12, 14, 3))
        for lens_point, offset in zip(plan.locations.uv, plan.locations.offset, strict=True):
            seen = xy + slope * (lens_point - uv)
            for row, column in np.ndindex(12, 14):
                distance = np.hypot(*(seen - offset - (column + 0.5, row + 0.5)).T)
                tent = np.maximum(1 - distance / (0.8 * plan.rule.radius), 0)
                if tent.any():
                    expected[row, column] += tent @ color / tent.sum() / 8
        # At the image's border no sample may be near.
        np.testing.assert_allclose(image[2:-2, 2:-2], expected[2:-2, 2:-2], atol=1e-4)

    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    def test_glossy_samples_count_by_their_distance_on_the_lens(self, engine: str) -> None:
        """One plane with a highlight that only one half of the lens sees; seen from either."""
        samples = make_samples("still", 10, 10, 8, 8.0)
        right = samples.uv[..., :1] > 0
        samples = replace(
            samples,
            depth=np.full_like(samples.depth, 9.0),
            color=np.where(right, np.ones(3, np.float32), np.float32(0)),
            bandwidth=np.full_like(samples.depth, 0.15),
        )
        plan = make_plan(samples, TemporalOptions())
        for u, radiance in ((0.6, 1.0), (-0.6, 0.0)):
            one = Locations(*(np.array(values, np.float32) for values in ([[u, 0]], [0], [[0, 0]], [1])))
            image, _ = run(samples, engine, plan=replace(plan, locations=one))
            assert np.abs(image - radiance).max() < 0.1
            assert np.abs(image - radiance).mean() < 0.01
            matte, _ = run(replace(samples, bandwidth=None), engine, plan=replace(plan, locations=one))
            assert 0.2 < matte.mean() < 0.8

    @pytest.mark.parametrize("engine", ["cpu", "reference"])
    def test_nearest_samples_fill_in_where_there_are_none(self, engine: str) -> None:
        samples = make_samples("still", 24, 24, 2, 0.0)
        kept = np.zeros((24, 24), bool)
        kept[:, :3] = True
        xy = np.where(kept[..., None, None], samples.xy, OFF_IMAGE)
        samples = replace(samples, xy=xy, color=np.full_like(samples.color, 0.7))
        image, counts = run(samples, engine, locations=4)
        reach = 2 + 8 * make_plan(samples, TemporalOptions()).rule.radius
        np.testing.assert_allclose(image[:, : int(reach) - 2], 0.7, rtol=1e-6)
        assert not image[:, int(reach) + 3 :].any()
        assert counts.empty > 0


class TestRareCases:
    @pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
    def test_a_sample_exactly_at_a_location(self, order: int) -> None:
        """It is a corner of triangles like any other, wherever it comes in the buffer."""
        front = [(0.5, 0.1), (0.9, 0.5), (0.6, -0.4), (0.8, 0.8)]
        middle = np.roll([(0.0, 0.0), (1.0, 1.0), (-1.0, 0.9), (-0.9, -0.8), (0.9, -0.9)], order, axis=0)
        back = [(0.2, 0.3), (-0.3, 0.2), (-0.2, -0.25), (0.3, -0.2)]
        xy = np.concatenate([front, middle, back])[:, None, None] + 10.0
        depth = np.repeat([0.1, 0.2, 0.5], [4, 5, 4])[:, None, None]
        samples = SampleBuffer(xy, np.zeros_like(xy), depth, depth[..., None] * np.ones(3), Lens(-10.0, 0.0))
        rule = SurfaceRule(1.0, 0.1, 0.05)
        place = np.array([[10, 10, 0, 0, 0]], np.float32)
        color, _, counts = kernel.reconstruct_locations(Hierarchy(samples, rule), rule, place)
        assert counts.covered == 1
        np.testing.assert_allclose(color, 0.2, rtol=1e-6)

    @pytest.mark.parametrize("engine", ["reference", "cpu"])
    @pytest.mark.parametrize("bandwidth", [1e-45, 1e-38, 1e-22])
    def test_the_narrowest_bandwidths(self, bandwidth: float, engine: str) -> None:
        """Their squares are 0 in float32, and so is the distance from a sample's own lens point."""
        samples = make_samples("still", 4, 4, 2, 1.0)
        samples = replace(
            samples, uv=np.zeros_like(samples.uv), bandwidth=np.full_like(samples.depth, bandwidth)
        )
        assert samples.bandwidth is not None
        plan = only(make_plan(samples, TemporalOptions()), 0)
        plan = replace(plan, locations=replace(plan.locations, uv=np.zeros((1, 2), np.float32)))
        image, _ = run(samples, engine, plan=plan)
        matte, _ = run(replace(samples, bandwidth=None), engine, plan=plan)
        np.testing.assert_allclose(image, matte, rtol=1e-5)

    def test_depths_and_lenses_at_the_ends_of_float32(self) -> None:
        samples = make_samples("moving", 6, 7, 2, 2.0)
        for depth, lens in ((3e38, Lens(-5.0, 1.0)), (1e38, Lens(-1e30, 1e25)), (1e-30, Lens(-1e-25, 1.0))):
            extreme = replace(
                samples, depth=np.where(samples.depth > 1, depth, samples.depth).astype(np.float32)
            )
            image, counts = run(replace(extreme, lens=lens), locations=8)
            assert np.isfinite(image).all()
            assert counts.locations == 8 * 42

    def test_equal_slopes_are_told_apart_alike(self) -> None:
        samples = make_samples("still", 12, 16, 4, 8.0)
        rng = np.random.default_rng(0)
        tied = np.where(rng.random(samples.depth.shape) < 0.5, np.float32(1e6), samples.depth)
        samples = replace(samples, depth=tied.astype(np.float32))
        expected, counts = run(samples, "reference", locations=8)
        actual, native_counts = run(samples, locations=8)
        assert_twins(actual, expected)
        assert_like(native_counts, counts)

    def test_crowds_are_thinned_alike(self) -> None:
        """What recedes to many times its depth crowds around the principal point."""
        samples = make_samples("still", 16, 16, 4, 1.0)
        w = samples.depth
        motion = np.stack([12 * w * 8, 12 * w * 8, 12 * w], axis=-1)
        receding = replace(samples, time=np.zeros_like(w), motion=motion.astype(np.float32))
        plan = make_plan(receding, TemporalOptions(locations=8, shutter=(1.0, 1.0)))
        expected, _ = run(receding, "reference", plan=plan)
        actual, _ = run(receding, plan=plan)
        assert_agree(actual, expected, tolerance=1e-3, flips=0.05, jump=1.0)
