"""Planes and the images made of them: what must not change them, extreme buffers, and options."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, Multiplane, SampleBuffer, SampleError, _native, reconstruct, save_image
from fewrays.method import Image
from fewrays.multiplane import copies
from fewrays.multiplane.slabs import SlabRule, assign_planes
from fewrays.samples import OFF_IMAGE

LENS = Lens(-40.0, 8.0)  # focused at 5


def render(samples: SampleBuffer, lens: Lens | None = None, **given: Any) -> Image:
    """Image of 16 views, unless told otherwise, which must be finite."""
    options = {"views": 16, "threads": 1, **given}
    planes = Multiplane.build(samples, threads=1)
    image = planes.render(lens, **options)
    assert image.shape == (samples.height, samples.width, 3)
    assert image.dtype == np.float32
    assert np.isfinite(image).all()
    return image


def moving(samples: SampleBuffer) -> SampleBuffer:
    rng = np.random.default_rng(5)
    motion = rng.integers(-6, 7, (*samples.depth.shape, 3)) * samples.depth[..., None]
    motion[..., 2] = 0
    return replace(samples, time=rng.random(samples.depth.shape, np.float32), motion=motion)


def take(samples: SampleBuffer, order: Any) -> SampleBuffer:
    """Put samples into another order, whatever pixels they were taken for."""
    arrays = {name: getattr(samples, name) for name in samples.field_names()}
    shape = samples.depth.shape
    return replace(
        samples,
        **{n: a.reshape(-1, *a.shape[3:])[order].reshape(*shape, *a.shape[3:]) for n, a in arrays.items()},
    )


class TestWhatMustNotMatter:
    @pytest.mark.parametrize("motion", [False, True])
    @pytest.mark.parametrize("threads", [2, 5])
    def test_number_of_threads(self, threads: int, motion: bool) -> None:
        """Bit for bit: several parts of the planes, several tiles."""
        samples = moving(random_buffer(9, 70, 2, LENS)) if motion else random_buffer(70, 90, 2, LENS)
        one, several = (Multiplane.build(samples, threads=n) for n in (1, threads))
        np.testing.assert_array_equal(one.maps.slots, several.maps.slots)
        np.testing.assert_array_equal(one.maps.halves, several.maps.halves)
        np.testing.assert_array_equal(
            one.render(views=8, threads=1), several.render(views=8, threads=threads)
        )

    @pytest.mark.parametrize("motion", [False, True])
    def test_order_of_samples(self, motion: bool) -> None:
        samples = random_buffer(17, 40, 3, LENS, off_image=0.1)
        samples = moving(samples) if motion else samples
        order = np.random.default_rng(2).permutation(samples.depth.size)
        assert_agree(render(take(samples, order)), render(samples), tolerance=5e-3, flips=0.01, jump=0.02)

    def test_dropped_samples(self) -> None:
        """They hold no evidence, whatever else they hold."""
        samples = random_buffer(12, 20, 4, LENS)
        color, depth, xy = samples.color.copy(), samples.depth.copy(), samples.xy.copy()
        color[:, :, 1] = np.nan
        fields = {name: getattr(samples, name) for name in samples.field_names()}
        with pytest.warns(UserWarning, match="dropped"):
            with_nans = SampleBuffer(**fields | {"color": color}, lens=LENS, nan="drop")
        xy[:, :, 1], depth[:, :, 1] = OFF_IMAGE, 77.0
        np.testing.assert_array_equal(render(with_nans), render(replace(samples, xy=xy, depth=depth)))
        kept = {name: np.delete(value, 1, axis=2) for name, value in fields.items()}
        assert_agree(render(with_nans), render(SampleBuffer(**kept, lens=LENS)), tolerance=5e-3)

    @pytest.mark.parametrize("exponent", [-40, -3, 10, 60])
    def test_exposure(self, exponent: int) -> None:
        """A power of two leaves every bit of the maps alone: HDR stays HDR."""
        samples = random_buffer(12, 20, 4, LENS)
        scaled = replace(samples, color=np.ldexp(samples.color, exponent))
        np.testing.assert_array_equal(render(scaled), np.ldexp(render(samples), exponent))

    def test_brightness_elsewhere(self) -> None:
        """A plane keeps its precision whatever shines from another depth."""
        samples = random_buffer(12, 20, 4, LENS)
        depth = np.where(samples.depth < 8, 2.0, 20.0).astype(np.float32)
        dim = replace(samples, depth=depth, color=0.05 * samples.color)
        bright = replace(dim, color=np.where(depth[..., None] > 8, np.float32(1e9), dim.color))
        maps, others = (Multiplane.build(each, threads=1).maps for each in (dim, bright))
        assert others.scale[1] > 1e6 * others.scale[0] == 1e6 * maps.scale[0]
        front = maps.slots[: maps.grid.first_slot[1]].max() * _native.UNIT_HALVES
        assert front > 0
        np.testing.assert_array_equal(others.halves[:front], maps.halves[:front])

    def test_bands(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Planes may be smoothed for any number of rows at once."""
        samples = random_buffer(70, 40, 2, LENS)
        whole = render(samples, smoothing=1.0)
        monkeypatch.setattr(copies, "_MOST_BYTES", 1)
        np.testing.assert_array_equal(render(samples, smoothing=1.0), whole)

    def test_negative_radiance(self) -> None:
        samples = random_buffer(12, 20, 4, LENS)
        np.testing.assert_array_equal(render(replace(samples, color=-samples.color)), -render(samples))

    def test_lens_positions_where_all_is_in_focus(self) -> None:
        samples = random_buffer(12, 20, 4, LENS)
        samples = replace(samples, depth=np.full_like(samples.depth, 5.0))
        np.testing.assert_array_equal(render(samples), render(replace(samples, uv=-0.3 * samples.uv)))


class TestExtremeBuffers:
    @pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 65), (17, 1), (13, 31)])
    @pytest.mark.parametrize("spp", [1, 3])
    def test_sizes(self, height: int, width: int, spp: int) -> None:
        samples = random_buffer(height, width, spp, LENS)
        image = render(samples)
        assert image.min() > -1e-6
        assert image.max() < samples.color.max() * 1.001

    @pytest.mark.parametrize("blur", [0.0, 1000.0])
    def test_slopes(self, blur: float) -> None:
        samples = random_buffer(12, 20, 4, Lens(-5 * blur, blur))
        image = render(samples)
        assert image.mean() == pytest.approx(samples.color.mean(), rel=0.25)

    def test_one_slope(self) -> None:
        samples = random_buffer(12, 20, 4, LENS)
        planes = Multiplane.build(replace(samples, depth=np.full_like(samples.depth, 9.0)), threads=1)
        assert planes.maps.plane_count == 1
        assert planes.render(views=16).mean() == pytest.approx(samples.color.mean(), rel=0.1)

    def test_all_dropped(self) -> None:
        samples = random_buffer(12, 20, 2, LENS)
        assert not render(replace(samples, xy=np.full_like(samples.xy, OFF_IMAGE))).any()

    def test_all_outside_the_image(self) -> None:
        samples = random_buffer(12, 20, 2, LENS)
        assert render(replace(samples, xy=samples.xy + 1e5)).max() == 0

    @pytest.mark.parametrize("share", [0.5, 0.95])
    def test_adaptive_sampling(self, share: float) -> None:
        """Most samples of most pixels are missing: what is left still covers the image."""
        samples = random_buffer(40, 50, 4, LENS)
        rng = np.random.default_rng(3)
        gone = rng.random(samples.depth.shape) < share * rng.random((40, 50, 1)) ** 0.2
        samples = replace(samples, xy=np.where(gone[..., None], np.float32(OFF_IMAGE), samples.xy))
        image = render(samples)
        assert image.min() > 0
        assert image.mean() == pytest.approx(samples.color[~gone].mean(), rel=0.1)

    @pytest.mark.parametrize("slope", [-1e5, -1e9])
    def test_a_sample_at_the_lens(self, slope: float) -> None:
        """A speck of dust there is blurred beyond sight, and takes no memory."""
        samples = random_buffer(12, 20, 4, LENS)
        depth = samples.depth.copy()
        depth[3, 4, 0] = LENS.c0 / slope
        planes = Multiplane.build(replace(samples, depth=depth), threads=1)
        assert planes.nbytes < 30e6
        without = replace(samples, xy=samples.xy.copy())
        without.xy[3, 4, 0] = OFF_IMAGE
        assert_agree(planes.render(views=16), render(without), tolerance=0.05)

    def test_more_motions_than_16_bits_number(self) -> None:
        """Cells of motion grow until each plane has a number; each sample is in a plane that moves so."""
        samples = random_buffer(100, 100, 4, LENS)
        velocity = np.random.default_rng(5).uniform(-300, 300, (*samples.depth.shape, 2))
        motion = np.concatenate([velocity, np.zeros((*samples.depth.shape, 1))], axis=3)
        motion = (motion * samples.depth[..., None]).astype(np.float32)
        samples = replace(samples, time=np.full(samples.depth.shape, np.float32(0.5)), motion=motion)
        assignment = assign_planes(samples, SlabRule(motion_cell=1.5))
        distinct = np.unique(np.floor(velocity.reshape(-1, 2) / 1.5 + 0.5), axis=0)
        assert len(distinct) > 2**14  # cells of one and a half pixels would be too many, depths apart
        assert len(assignment.slope) < 2**15
        own = assignment.motion[assignment.plane_of]
        np.testing.assert_allclose(own, velocity.reshape(-1, 2), atol=6.01)

    @pytest.mark.parametrize("brightest", [1e30, 3e38])
    def test_radiance_near_the_end_of_float32(self, brightest: float) -> None:
        samples = random_buffer(6, 9, 2, LENS)
        color = (samples.color / samples.color.max() * brightest).astype(np.float32)
        assert render(replace(samples, color=color)).max() > 0.1 * brightest

    def test_a_scene_without_light(self) -> None:
        samples = random_buffer(6, 9, 2, LENS)
        assert not render(replace(samples, color=np.zeros_like(samples.color))).any()


@settings(max_examples=20)
@given(value=st.floats(1e-5, 1.0), brightest=st.sampled_from([1.0, 30.0, 1000.0]))
def test_half_precision_rounds_to_the_nearest(value: float, brightest: float) -> None:
    """Whatever the brightest sample is, 11 significant bits of the others are kept."""
    samples = random_buffer(4, 40, 4, LENS)
    color = np.full_like(samples.color, value)
    color[:, 36:] = brightest
    samples = replace(samples, depth=np.full_like(samples.depth, 5.0), color=color)
    np.testing.assert_allclose(render(samples)[:, :4], value, rtol=2**-11 * 1.01)


class TestThrough:
    planes = Multiplane.build(random_buffer(12, 20, 3, LENS), threads=1)

    @pytest.mark.parametrize(
        "lens", [LENS.refocus(3.0), LENS.refocus(float("inf"), 0.3), LENS.refocus(None, 0)]
    )
    def test_slopes_are_those_of_the_same_depths(self, lens: Lens) -> None:
        maps = self.planes.maps
        through = maps.through(lens)
        # Planes at slopes beyond that of infinity have no depth, but the same law.
        inverse_depth = (maps.shear.slope - LENS.c1) / LENS.c0
        np.testing.assert_allclose(through.shear.slope, lens.c0 * inverse_depth + lens.c1, atol=1e-12)
        assert through.lens == lens
        assert through.halves is maps.halves

    def test_the_lens_of_the_samples_changes_nothing(self) -> None:
        np.testing.assert_array_equal(self.planes.render(LENS, views=8), self.planes.render(views=8))
        assert self.planes.lens == LENS

    def test_a_pinhole_tells_no_depths_apart(self) -> None:
        samples = random_buffer(6, 9, 2, LENS).refocus(aperture_scale=0.0)
        planes = Multiplane.build(samples, threads=1)
        planes.render(samples.lens, views=8)
        planes.render(replace(samples.lens, aperture="gaussian"), views=8)
        with pytest.raises(SampleError, match="pinhole") as caught:
            planes.render(LENS)
        assert caught.value.field == "lens"

    def test_the_smallest_aperture_is_the_pinhole_s_image(self) -> None:
        samples = random_buffer(12, 20, 4, LENS)
        planes = Multiplane.build(samples, threads=1, fine_to=100.0)
        small, none = (planes.render(LENS.refocus(None, scale), views=32) for scale in (1e-4, 0.0))
        assert_agree(small, none, tolerance=2e-3)

    @pytest.mark.parametrize("lens", [LENS.refocus(1e-3), LENS.refocus(1e-12), LENS.refocus(None, 1e9)])
    def test_lenses_out_of_all_proportion(self, lens: Lens) -> None:
        """What they would show none of the samples saw; it must do no harm."""
        assert np.isfinite(self.planes.render(lens, views=8)).all()


class TestCatsEye:
    def test_nothing_changes_in_the_centre_or_what_is_in_focus(self) -> None:
        samples = random_buffer(33, 45, 4, LENS)
        sharp = replace(samples, depth=np.full_like(samples.depth, 5.0))
        # Each place in the pixel goes with a lens point: leaving points out shows a little.
        assert_agree(render(sharp, views=128, cats_eye=1.0), render(sharp, views=128), tolerance=0.2)
        plain, eye = render(samples), render(samples, cats_eye=1.0)
        np.testing.assert_allclose(eye[16, 22], plain[16, 22], rtol=0.02)
        assert np.abs(eye - plain)[0, 0].max() > 0.01

    def test_darkens_the_corners_by_the_area_that_is_cut_off(self) -> None:
        samples = random_buffer(33, 45, 2, LENS)
        samples = replace(samples, color=np.ones_like(samples.color))
        bright, dark = (render(samples, views=512, cats_eye=1.0, darken=value) for value in (False, True))
        # A corner's centre is a little less than a half diagonal away; docs of `fewrays.vignetting`.
        assert dark[0, 0, 0] / bright[0, 0, 0] == pytest.approx(0.39 + 0.61 * 0.025, abs=0.02)
        assert dark[16, 22, 0] == pytest.approx(bright[16, 22, 0], rel=1e-3)

    def test_no_pixel_is_lost_where_nothing_passes_the_rim(self, tmp_path: Path) -> None:
        """An aperture at the rim of the lens is behind the front rim as a whole in one corner."""
        picture = np.zeros((32, 32), np.float32)
        picture[15:17, 28:30] = 1.0
        save_image(tmp_path / "aperture.exr", picture)
        samples = random_buffer(33, 45, 2, LENS)
        assert render(samples, cats_eye=1.0, aperture_image=tmp_path / "aperture.exr").min() > 0


class TestCells:
    @pytest.mark.parametrize(("spp", "others"), [(1, 1), (2, 1), (3, 2), (4, 2)])
    def test_out_of_focus_no_smaller_than_samples_are_dense(self, spp: int, others: int) -> None:
        samples = random_buffer(40, 60, spp, LENS)
        fine_to = float(np.median(np.abs(samples.slope())))
        maps = Multiplane.build(samples, threads=1, fine_to=fine_to).maps
        in_focus = np.abs(maps.shear.slope) <= fine_to
        assert (maps.grid.cells[in_focus] == 3).all()
        assert (maps.grid.cells[~in_focus] == others).all()

    def test_dropped_samples_do_not_count(self) -> None:
        samples = random_buffer(40, 60, 4, LENS)
        xy = samples.xy.copy()
        xy[:, :, 2:] = OFF_IMAGE
        assert Multiplane.build(replace(samples, xy=xy), threads=1, fine_to=0.0).maps.grid.cells.max() == 1


class TestMemory:
    samples = random_buffer(40, 60, 3, LENS)

    def test_planes_with_most_blur_lose_resolution_first(self) -> None:
        fine = Multiplane.build(self.samples, threads=1)
        assert fine.maps.grid.cells.min() == 2
        sizes = []
        for share in (0.7, 0.4, 0.0):
            maps = Multiplane.build(self.samples, threads=1, memory=share * fine.nbytes / 2**20).maps
            blur = np.abs(maps.shear.slope)
            coarse = maps.grid.cells == 1
            assert coarse.any()
            assert blur[coarse].min() >= max(blur[~coarse], default=0.0)
            assert maps.halves.nbytes <= share * fine.nbytes or coarse.all()
            sizes.append(maps.nbytes)
        assert sorted(sizes, reverse=True) == sizes

    def test_none_is_needed_where_all_is_in_focus(self) -> None:
        samples = self.samples.refocus(aperture_scale=0.0)
        assert (Multiplane.build(samples, threads=1).maps.grid.cells == 3).all()


class TestOptions:
    samples = random_buffer(4, 5, 2, LENS)

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("thickness", 0.05),
            ("thickness", 9.0),
            ("thickness", float("nan")),
            ("linear_to", 0.5),
            ("linear_to", 1e4),
            ("cells", 0),
            ("cells", 4),
            ("fine_to", -1.0),
            ("fine_to", float("nan")),
            ("prior", 0.0),
            ("prior", 1000.0),
            ("memory", -1.0),
            ("memory", float("nan")),
            ("motion_cell", 0.1),
            ("motion_cell", 100.0),
        ],
    )
    def test_of_building_out_of_range(self, name: str, value: Any) -> None:
        with pytest.raises(SampleError, match=re.escape(repr(value))) as caught:
            Multiplane.build(self.samples, **{name: value})
        assert caught.value.field == name
        with pytest.raises(SampleError):
            reconstruct(self.samples, "multiplane", **{name: value})

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("views", 0),
            ("views", 65537),
            ("smoothing", -0.1),
            ("smoothing", 2.5),
            ("smoothing", float("nan")),
            ("cats_eye", 1.5),
            ("cats_eye", -0.1),
            ("pixel_filter", "sinc"),
            ("sigma_pix", 0.0),
            ("shutter", (0.6, 0.4)),
            ("shutter", (-0.1, 1.0)),
            ("shutter_response", "round"),
            ("blades", 2),
            ("squeeze", 0.0),
        ],
    )
    def test_of_rendering_out_of_range(self, name: str, value: Any) -> None:
        with pytest.raises(SampleError) as caught:
            Multiplane.build(self.samples).render(**{name: value})
        assert caught.value.field == name
        with pytest.raises(SampleError):
            reconstruct(self.samples, "multiplane", **{name: value})

    def test_unknown(self) -> None:
        with pytest.raises(SampleError, match=r"views: no such option for Multiplane.build.*prior") as caught:
            Multiplane.build(self.samples, views=8)
        assert caught.value.field == "views"
        with pytest.raises(SampleError, match=r"prior: no such option for Multiplane.render.*views"):
            Multiplane.build(self.samples).render(prior=1.0)
        with pytest.raises(SampleError, match="threads"):
            Multiplane.build(self.samples, threads=0)

    def test_both_steps_together(self) -> None:
        whole = reconstruct(self.samples, "multiplane", prior=1.0, views=9)
        np.testing.assert_array_equal(whole, Multiplane.build(self.samples, prior=1.0).render(views=9))

    def test_what_it_says_of_itself(self) -> None:
        planes = Multiplane.build(self.samples)
        assert re.fullmatch(r"Multiplane\(5 x 4 pixels, \d+ planes, \d+ bytes a pixel\)", repr(planes))
        assert (planes.height, planes.width) == (4, 5)
