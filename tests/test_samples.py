"""What a sample buffer accepts, converts and rejects."""

import dataclasses
import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays.errors import SampleError
from fewrays.lens import Lens
from fewrays.samples import OFF_IMAGE, SampleBuffer

SHAPE = (3, 4, 2)
LENS = Lens(-10.0, 2.0, sampling="square")


def _fields(**changes: Any) -> dict[str, Any]:
    rng = np.random.default_rng(5)
    fields = {
        "xy": rng.uniform(0, 3, (*SHAPE, 2)),
        "uv": rng.uniform(-1, 1, (*SHAPE, 2)),
        "depth": rng.uniform(1, 9, SHAPE),
        "color": rng.random((*SHAPE, 3)),
        "time": rng.random(SHAPE),
        "motion": rng.normal(size=(*SHAPE, 3)),
        "bandwidth": rng.uniform(0.01, 2, SHAPE),
    }
    fields = {name: array.astype(np.float32) for name, array in fields.items()}
    return {**fields, "lens": LENS, **changes}


def test_sizes_and_slopes() -> None:
    samples = SampleBuffer(**_fields())
    assert (samples.height, samples.width, samples.spp) == SHAPE
    assert samples.nbytes == 24 * 4 * (2 + 2 + 1 + 3 + 1 + 3 + 1)
    np.testing.assert_allclose(samples.slope(), -10 / samples.depth + 2, rtol=1e-6)
    assert samples.slope().dtype == np.float32
    assert repr(samples) == "SampleBuffer(4 x 3 pixels, 2 spp, lens=Lens(c0=-10.0, c1=2.0, ...), moving)"


def test_float32_arrays_are_shared_and_others_converted() -> None:
    fields = _fields()
    samples = SampleBuffer(**fields)
    assert np.shares_memory(samples.color, fields["color"])
    converted = SampleBuffer(
        **_fields(depth=np.full(SHAPE, 3, np.int64), color=np.ones((*SHAPE, 3)).tolist())
    )
    assert converted.depth.dtype == converted.color.dtype == np.float32
    strided = SampleBuffer(**_fields(depth=np.ones((*SHAPE, 2), np.float32)[..., 0]))
    assert strided.depth.flags.c_contiguous


def test_another_aperture_shares_the_arrays() -> None:
    samples = SampleBuffer(**_fields())
    other = samples.with_lens(dataclasses.replace(LENS, aperture="gaussian"))
    assert np.shares_memory(other.xy, samples.xy)
    assert other.lens.aperture == "gaussian"


@pytest.mark.parametrize(("focus", "scale"), [(3.0, 1.0), (None, 0.5), (np.inf, 2.0), (1.5, 0.0)])
def test_refocusing_keeps_what_the_lens_centre_sees(focus: float | None, scale: float) -> None:
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.5, 50.0, SHAPE)
    samples = SampleBuffer(**_fields(depth=depth, uv=rng.uniform(-0.7, 0.7, (*SHAPE, 2))))
    other = samples.refocus(focus, scale)
    assert other.lens == LENS.refocus(focus, scale)
    seen = [s.xy - s.slope()[..., None] * s.uv for s in (samples, other)]
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-4)
    back = other.with_lens(LENS)
    np.testing.assert_allclose(back.xy, samples.xy, atol=1e-4)


@pytest.mark.parametrize("scale", [0.25, 3.0])
def test_bandwidth_stays_the_same_distance_on_the_lens(scale: float) -> None:
    fields = _fields()
    fields["bandwidth"][0, 1, 0] = np.inf
    samples = SampleBuffer(**fields)
    other = samples.refocus(3.0, scale)
    assert other.bandwidth is not None
    np.testing.assert_allclose(other.bandwidth * scale, fields["bandwidth"], rtol=1e-6)
    assert other.bandwidth.dtype == np.float32
    back = other.with_lens(LENS).bandwidth
    assert back is not None
    np.testing.assert_allclose(back, fields["bandwidth"], rtol=1e-6)


def test_bandwidth_does_not_depend_on_the_focus() -> None:
    samples = SampleBuffer(**_fields())
    refocused = samples.refocus(3.0).bandwidth
    assert refocused is not None
    assert samples.bandwidth is not None
    assert np.shares_memory(refocused, samples.bandwidth)


@pytest.mark.parametrize("pinhole", [LENS.refocus(aperture_scale=0), Lens(0.0, 0.0, sampling="square")])
def test_bandwidth_through_a_pinhole_is_unlimited(pinhole: Lens) -> None:
    samples = SampleBuffer(**_fields()).with_lens(pinhole)
    assert samples.bandwidth is not None
    assert (samples.bandwidth == np.inf).all()
    wide = samples.with_lens(LENS).bandwidth
    assert wide is not None
    assert (wide == np.inf).all()


def test_the_widest_lens_leaves_a_positive_bandwidth() -> None:
    samples = SampleBuffer(
        **_fields(bandwidth=np.full(SHAPE, 1e-20), lens=Lens(-1e-20, 0, sampling="square"))
    )
    bandwidth = samples.with_lens(Lens(-1e20, 0, sampling="square")).bandwidth
    assert bandwidth is not None
    assert (bandwidth > 0).all()


def test_bandwidth_is_optional_and_can_be_left_out() -> None:
    assert "bandwidth" not in SampleBuffer(**_fields(bandwidth=None)).refocus(2.0, 0.5).field_names()
    samples = SampleBuffer(**_fields())
    assert samples.field_names()[-1] == "bandwidth"
    assert dataclasses.replace(samples, bandwidth=None).bandwidth is None


def test_positions_off_the_image_are_legal() -> None:
    SampleBuffer(**_fields(xy=np.full((*SHAPE, 2), -50.0)))


def test_colors_stay_high_dynamic_range() -> None:
    color = np.linspace(-1, 1e6, 72, dtype=np.float32).reshape(*SHAPE, 3)
    np.testing.assert_array_equal(SampleBuffer(**_fields(color=color)).color, color)


@pytest.mark.parametrize("name", ["xy", "uv", "color", "time", "motion", "bandwidth"])
def test_shapes_must_go_with_depth(name: str) -> None:
    fields = _fields()
    with pytest.raises(SampleError) as error:
        SampleBuffer(**{**fields, name: fields[name][:-1]})
    assert error.value.field == name
    assert str((2, *fields[name].shape[1:])) in str(error.value)


@pytest.mark.parametrize(
    "depth", [np.ones(4), np.ones((0, 4, 2)), np.ones((3, 4, 0)), np.broadcast_to(1.0, (1, 65_537, 1))]
)
def test_shapes_that_are_no_image(depth: np.ndarray) -> None:
    with pytest.raises(SampleError) as error:
        SampleBuffer(**_fields(depth=depth))
    assert error.value.field == "depth"


@pytest.mark.parametrize("value", [np.ones(SHAPE, complex), np.full(SHAPE, "far"), np.full(SHAPE, None)])
def test_only_real_numbers(value: np.ndarray) -> None:
    with pytest.raises(SampleError, match="real numbers"):
        SampleBuffer(**_fields(depth=value))


def test_lens_nan_and_motion_arguments() -> None:
    with pytest.raises(SampleError, match=r"^lens: .*dict"):
        SampleBuffer(**_fields(lens={"c0": -1}))
    with pytest.raises(SampleError, match=r"^nan: .*'keep'"):
        SampleBuffer(**_fields(nan="keep"))
    with pytest.raises(SampleError, match=r"^motion: "):
        SampleBuffer(**_fields(time=None))


@st.composite
def _places(draw: st.DrawFn) -> tuple[str, tuple[int, ...]]:
    name = draw(st.sampled_from(["xy", "uv", "depth", "color", "time", "motion", "bandwidth"]))
    shape = _fields()[name].shape
    return name, tuple(draw(st.integers(0, size - 1)) for size in shape)


@given(place=_places(), value=st.sampled_from([np.nan, np.inf, -np.inf]))
def test_values_that_are_not_finite_are_found(place: tuple[str, tuple[int, ...]], value: float) -> None:
    name, index = place
    fields = _fields()
    if name == "bandwidth":
        value = np.nan  # its infinities have tests of their own
    fields[name][index] = value
    with pytest.raises(SampleError) as error:
        SampleBuffer(**fields)
    assert error.value.field == name
    assert f"{list(index)}: {value}" in str(error.value)


def test_infinities_of_both_signs_are_counted() -> None:
    fields = _fields()
    fields["color"][0, 1, 0] = [np.inf, -np.inf, np.nan]
    with pytest.raises(SampleError, match=r"^color: 3 of 72 .* \[0, 1, 0, 0\]: inf"):
        SampleBuffer(**fields)


def test_overflow_to_float32_is_found() -> None:
    with pytest.raises(SampleError, match=r"^color: .*inf"):
        SampleBuffer(**_fields(color=np.full((*SHAPE, 3), 1e300)))


@given(places=st.lists(_places(), min_size=1, max_size=5))
def test_dropped_samples_leave_the_image_and_nothing_else_changes(
    places: list[tuple[str, tuple[int, ...]]],
) -> None:
    fields = _fields(nan="drop")
    clean = SampleBuffer(**_fields())
    for name, index in places:
        fields[name][index] = np.nan
    bad = {index[:3] for _, index in places}
    with pytest.warns(UserWarning, match=f"dropped {len(bad)} of 24 samples"):
        samples = SampleBuffer(**fields)
    dropped = np.zeros(SHAPE, bool)
    for index in bad:
        dropped[index] = True
    assert (samples.xy[dropped] == OFF_IMAGE).all()
    assert (samples.color[dropped] == 0).all()
    for name in samples.field_names():
        assert np.isfinite(getattr(samples, name)).all()
        np.testing.assert_array_equal(getattr(samples, name)[~dropped], getattr(clean, name)[~dropped])


def test_dropping_leaves_the_callers_arrays_alone() -> None:
    fields = _fields(nan="drop")
    fields["depth"][0, 0, 0] = np.inf
    with pytest.warns(UserWarning, match="dropped 1 of 24"):
        SampleBuffer(**fields)
    assert np.isinf(fields["depth"][0, 0, 0])


def test_nothing_to_drop_gives_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SampleBuffer(**_fields(nan="drop"))


@pytest.mark.parametrize(
    ("name", "value", "hint"),
    [
        ("depth", 0.0, "positive"),
        ("depth", -2.5, "positive"),
        ("depth", 1e-39, "overflows"),
        ("uv", 1.5, "lens radius"),
        ("time", -0.25, "shutter"),
        ("time", 1.25, "shutter"),
        ("bandwidth", 0.0, "positive"),
        ("bandwidth", -0.5, "positive"),
        ("bandwidth", -np.inf, "positive"),
    ],
)
def test_values_out_of_range_are_named(name: str, value: float, hint: str) -> None:
    fields = _fields()
    fields[name].reshape(-1)[-1] = value
    with pytest.raises(SampleError, match=hint) as error:
        SampleBuffer(**fields)
    assert error.value.field == name
    assert f"value {np.float32(value)} at {[size - 1 for size in fields[name].shape]} (1 such)" in str(
        error.value
    )


def test_square_lens_samples_are_no_disc() -> None:
    uv = np.full((*SHAPE, 2), 0.8)
    with pytest.raises(SampleError, match="unit disc"):
        SampleBuffer(**_fields(uv=uv, lens=Lens(-10.0, 2.0, sampling="disc")))
    SampleBuffer(**_fields(uv=uv, lens=Lens(-10.0, 2.0, sampling="gaussian")))
