"""The arithmetic and the checks behind the benchmarks' pages."""

import importlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def load_module(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def test_noise_is_taken_out_of_the_mean_squared_error(load_module: Any) -> None:
    scores = load_module("scores")
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.2, 0.8, 400_000)
    image = truth + rng.normal(0, 0.02, truth.shape)
    reference = truth + rng.normal(0, 0.01, truth.shape)

    def psnr(a: Any, b: Any) -> float:
        return float(-10 * np.log10(np.square(a - b).mean()))

    corrected = scores.without_noise(psnr(image, reference), psnr(reference, truth))
    assert corrected == pytest.approx(psnr(image, truth), abs=0.05)


def test_an_error_that_noise_explains_counts_as_none(load_module: Any) -> None:
    assert load_module("scores").without_noise(40.0, 39.9) == math.inf


def test_a_target_counts_as_missed_on_the_scenes_below_it(load_module: Any) -> None:
    quality = load_module("quality")
    margins = {"near": quality.Margin(5.1, 4.9), "far": quality.Margin(3.0, 3.5)}
    text = quality.verdict("minus peer", 5.0, margins)
    assert "**Missed** on far (+3.00 dB)" in text
    assert "the answer differs for near" in text
    assert "**Met**" in quality.verdict("minus peer", 3.0, margins)


def test_every_method_is_compared_under_its_own_pixel_filter(load_module: Any) -> None:
    contenders = load_module("contenders")
    methods = importlib.import_module("fewrays").METHODS
    filters = {name: contenders.pixel_filter_of(name) for name in (*methods, contenders.DENOISER)}
    assert {filters.pop(name) for name in ("box", "temporal", "multiplane", contenders.DENOISER)} == {"box"}
    assert set(filters.values()) == {"gaussian"}


def test_tables_line_up_and_refuse_ragged_rows(load_module: Any) -> None:
    table = load_module("report").markdown_table
    assert table(["a", "value"], [["long name", "1"]]).splitlines() == [
        "| a         | value |",
        "| :-------- | ----: |",
        "| long name |     1 |",
    ]
    with pytest.raises(ValueError, match="zip"):
        table(["a", "value"], [["only one"]])


def test_missing_renders_name_the_command(load_module: Any, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"python examples/render\.py serpent --spp 4"):
        load_module("example_renders").require_renders(tmp_path, ["serpent"], 4)


def test_pages_hold_the_chosen_parts_in_order_whichever_is_made_first(
    load_module: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pages, made = load_module("page_parts"), []

    def part(options: Any) -> Iterator[str]:
        made.append(options.repetitions)
        yield f"part {len(made)}"

    parts = {"a": part, "b": part, "c": part}
    monkeypatch.setattr("sys.argv", ["page.py", "--parts", "a", "c", "--out", str(tmp_path), "--keep", "k"])
    options = pages.parse_page_options("A page.", parts, kept="images")
    assert options.keep == Path("k")
    pages.make_page("some", iter(["# Title"]), parts, options, first="c")
    paragraphs = (tmp_path / "some-results.md").read_text().split("\n\n")
    assert [paragraphs[0], *paragraphs[2:]] == ["# Title", "part 2", "part 1\n"]
    assert paragraphs[1].startswith("- Command: `python benchmarks/some.py --parts a c`")
    assert made == [3, 3]
    assert (tmp_path / "images").is_dir()


@pytest.mark.parametrize("change", [0.0, 0.1])
def test_samples_of_another_scene_than_the_reference_are_noticed(
    load_module: Any, tmp_path: Path, change: float
) -> None:
    renders = load_module("example_renders")
    samples = load_module("workloads").leaf_planes(80, 120, 4, planes=2)
    image = importlib.import_module("fewrays").reconstruct(samples, "box")
    reference = image.copy()
    reference[:, 60:] *= 1 - change
    scene = renders.Scene("leaves", {"square": samples}, {"box": renders.Reference(reference, 1, 40.0)})
    if not change:
        renders.require_match(tmp_path, scene, image)
        return
    with pytest.raises(SystemExit, match="not of the same scene"):
        renders.require_match(tmp_path, scene, image)


def test_calls_are_timed_in_turns_after_a_round_that_does_not_count(load_module: Any) -> None:
    order: list[str] = []
    calls = [lambda: order.append("a"), lambda: order.append("b")]
    timings = load_module("timing").time_in_turns(calls, 2)
    assert order == ["a", "b"] * 3
    assert [len(timing.cpu) for timing in timings] == [len(timing.wall) for timing in timings] == [2, 2]


def test_plain_averaging_that_halves_its_error_follows_the_law(load_module: Any) -> None:
    scores, counts = load_module("scores"), load_module("sample_counts")
    found = {spp: scores.Score(0.0, 20 + 10 * math.log10(spp)) for spp in (16, 2, 8)}
    law = counts.plain_law(found)
    assert law.exponent == pytest.approx(-1)
    assert law.last_exponent == pytest.approx(-1)
    assert law.needed(scores.Score(0.0, 50.0).error) == pytest.approx(1000)
    found[16] = scores.Score(0.0, found[8].corrected)
    assert counts.plain_law(found).last_exponent == pytest.approx(0)
    assert counts.plain_law({8: found[8], 16: found[8]}).cells == ["0.00", "0.00"]
    single = counts.plain_law({8: found[8]})
    assert math.isnan(single.exponent)
    assert single.cells == ["", ""]


def test_samples_that_have_not_been_rendered_are_named_with_their_command(load_module: Any) -> None:
    counts = load_module("sample_counts")
    score = load_module("scores").Score(30.0, 30.0)
    scores = {name: {8: score} for name in load_module("contenders").RIVALS}
    measured = counts.SampleCounts(
        "serpent", scores, {"square": {8: score}, "gaussian": {4: score, 8: score}}
    )
    text = "\n".join(counts.section([measured]))
    assert "missing: 1 spp, 2 spp, 4 spp, 16 spp" in text
    assert "nan" not in text
    assert "python examples/render.py serpent --spp 1 2 4 16 --reference-spp 0" in text


@pytest.mark.parametrize(
    ("gains", "verdict"), [((1.6, 1.6), "Met"), ((1.2, 1.3), "Missed"), ((4.0, -0.1), "Missed")]
)
def test_the_gain_over_the_foundation_must_reach_the_average_without_a_loss(
    load_module: Any, gains: tuple[float, float], verdict: str
) -> None:
    foundation, score = load_module("foundation"), load_module("scores").Score
    both = [
        foundation.Gain(name, score(30.0, 30.0), score(30 + gain, 30 + gain))
        for name, gain in zip(("near", "far"), gains, strict=True)
    ]
    assert f"**{verdict}**" in foundation.verdict(both)


def test_missing_images_of_the_foundation_are_not_judged(load_module: Any, tmp_path: Path) -> None:
    foundation = load_module("foundation")
    image = np.zeros((2, 2, 3), np.float32)
    reference = load_module("example_renders").Reference(image, 1, 40.0)
    assert foundation.measure_gain(tmp_path, "serpent", 8, image, reference) is None
    text = "\n".join(foundation.section([], ["serpent"], 8))
    assert "missing for serpent" in text
    assert "**" not in text


def test_steps_at_tile_borders_stand_out_in_the_true_grid_only(load_module: Any) -> None:
    jump_ratios = load_module("seams").jump_ratios
    rng = np.random.default_rng(2)
    noise = rng.normal(0, 1, (80, 96, 3))
    assert np.abs(jump_ratios(noise, 16) - 1).max() < 0.1
    tiles = np.kron(rng.normal(0, 1, (5, 6, 1)), np.ones((16, 16, 1)))
    ratios = jump_ratios(noise + tiles, 16)
    assert ratios[0] > 1.5
    assert ratios[1:].max() < 1.1


def test_a_line_is_compared_with_itself_whatever_the_image_shows_there(load_module: Any) -> None:
    seams = load_module("seams")
    rng = np.random.default_rng(6)
    content = rng.normal(0, 1, (130, 1, 3)) * np.ones((1, 100, 1)) * (np.arange(130) % 16 == 3)[:, None, None]
    start, tile = 9, 16

    def seamed(size: float, phase: int) -> Any:
        row, column = ((start + np.arange(n) - phase) // tile for n in content.shape[:2])
        noise = rng.normal(0, 0.1, content.shape)
        return content + noise + size * ((row[:, None] + column) % 2)[..., None]

    ratio, uncertainty = seams.paired_ratio(seamed(0.0, 0), seamed(0.0, 8), start, tile)
    assert ratio == pytest.approx(1, abs=4 * uncertainty)
    assert uncertainty < 0.05
    ratio, _ = seams.paired_ratio(seamed(0.3, 0), seamed(0.3, 8), start, tile)
    assert ratio > 1.2


def test_a_frame_that_pops_stands_out_of_steady_change(load_module: Any) -> None:
    popping = load_module("popping")
    rng = np.random.default_rng(4)
    truths = [np.full((8, 8, 3), 0.1 * number, np.float32) for number in range(60)]
    images = [truth + np.float32(0.01) * rng.random(truth.shape, np.float32) for truth in truths]
    images[30:] = [image + np.float32(0.05) for image in images[30:]]
    change = popping.change_beyond_truth(images, truths, 1)
    slide = popping.Slide("steps", "layered", np.arange(1.0, 60.0), change)
    assert slide.slopes[slide.standing_out.argmax()] == 30
    assert slide.standing_out.max() > popping.TARGET
    assert np.delete(slide.standing_out, 29).max() < popping.TARGET
    assert "**Missed** on steps" in popping.verdict([slide])


@pytest.mark.parametrize("pixel_filter", ["gaussian", "box"])
def test_the_edge_that_slides_has_an_exact_truth(load_module: Any, pixel_filter: str) -> None:
    popping, analytic = load_module("popping"), importlib.import_module("fewrays.sources.analytic")
    scene = popping._edge()
    size = popping._SIZE
    for slope in (-6.0, 0.0, 2.0):
        many = analytic.reference(
            scene.planes(slope), popping._LENS, *size, spp=16, pixel_filter=pixel_filter
        ).mean(axis=0)
        np.testing.assert_allclose(many, scene.truth(slope, pixel_filter)[0], atol=0.02)


def test_a_lights_rays_stay_within_its_footprint(load_module: Any) -> None:
    lights = load_module("lights")
    analytic = importlib.import_module("fewrays.sources.analytic")
    for case in lights.CASES:
        samples = analytic.sample(case.planes(), lights.LENS, lights.SIZE, lights.SIZE, 4)
        lit = (samples.color > lights.RADIANCE / 2).any(axis=(2, 3))
        assert not lit[~case.footprint()].any()
        spare = case.footprint().any(axis=0).sum() - lit.any(axis=0).sum()
        assert 8 <= spare <= 13


def test_lost_light_and_sparkle_are_told_apart(load_module: Any) -> None:
    lights = load_module("lights")
    footprint = np.zeros((6, 6), bool)
    footprint[2:4, 2:4] = True
    truth = np.where(footprint[..., None], 10.0, 0.0) * np.ones(3)
    dim, sparkling = 0.9 * truth, truth.copy()
    sparkling[0, 0] = 1.0
    found = lights.behaviour("box", [dim, sparkling], truth, footprint)
    np.testing.assert_allclose(found.totals, [0.9, 1.025])
    assert (found.outside, found.inside, found.least) == (pytest.approx(0.1), 0.0, 0.0)
    assert found.systematic == pytest.approx(0.05)


def test_a_window_on_a_plane_shows_what_the_whole_image_does(load_module: Any) -> None:
    workloads, analytic = load_module("workloads"), importlib.import_module("fewrays.sources.analytic")
    planes = workloads.leaf_stack(48, 64, planes=20, seed=1)
    xy, uv = np.random.default_rng(0).uniform((-1, -1), (1, 1), (2, 500, 2))
    xy = 20 + 15 * xy
    whole = analytic.trace(planes, workloads.LEAF_LENS, xy, uv)
    window = [workloads.seen_from(plane, 7, 5) for plane in planes]
    part = analytic.trace(window, workloads.LEAF_LENS, xy - [7, 5], uv)
    np.testing.assert_allclose(part[0], whole[0], atol=1e-6)
    np.testing.assert_array_equal(part[1], whole[1])
    assert len(np.unique(whole[1])) > 1


def test_time_that_grows_with_the_blur_is_reported_as_missed(load_module: Any) -> None:
    blur, timing = load_module("blur_radius"), load_module("timing").Timing
    steady = blur.Growth("leaves", "layered", tuple(timing([s], [s]) for s in (1.0, 1.1, 1.2, 1.4)))
    growing = blur.Growth("wall", "layered", tuple(timing([s], [s]) for s in (1.0, 1.1, 1.2, 1.6)))
    assert "**Met** on every workload" in blur.verdict([steady])
    assert "**Missed** on wall (1.60)" in blur.verdict([steady, growing])


def test_large_renders_of_a_scene_come_before_small_ones(load_module: Any, tmp_path: Path) -> None:
    speed = load_module("speed")
    (tmp_path / speed.LARGE).mkdir()
    for folder, scene in ((tmp_path, "foliage"), (tmp_path / speed.LARGE, "foliage"), (tmp_path, "citadel")):
        (folder / f"{scene}_square_8spp.npz").touch()
    found = {scene: path.parent for scene, path in speed.rendered(tmp_path).items()}
    assert found == {"foliage": tmp_path / speed.LARGE, "citadel": tmp_path}


def test_extra_memory_is_that_of_the_call(load_module: Any) -> None:
    measured = load_module("memory").extra_memory(lambda: np.ones(2**23))
    assert measured == pytest.approx(64, abs=16)  # sanitizers keep a shadow of an eighth


@pytest.mark.parametrize(("gain", "verdict"), [(10.4, "Met"), (9.9, "Missed")])
def test_the_gain_over_averaging_is_judged_at_16_spp_and_128_locations(
    load_module: Any, gain: float, verdict: str
) -> None:
    counts, score = load_module("temporal_counts"), load_module("scores").Score
    averages = [dict.fromkeys(counts.BASELINES, score(psnr, psnr)) for psnr in (20.0, 25.0)]
    few = counts.Counts(8, averages[0], {128: score(40.0, 40.0)})
    many = counts.Counts(16, averages[1], {64: score(0.0, 0.0), 128: score(25 + gain, 60.0)})
    text = "\n".join(counts.section([few, many], (4, 8, 16), (128,)))
    assert f"**{verdict}**: {gain:+.2f} dB" in text
    assert "missing: 4 spp" in text
    assert "butterflies --spp 4 --aperture disc" in text
    assert "Not measured" in counts.verdict(None)


@pytest.mark.parametrize(
    ("psnr", "flip", "verdict"), [(38.0, 0.04, "Met"), (37.0, 0.04, "Missed"), (38.0, 0.06, "Missed")]
)
def test_beating_the_denoiser_takes_psnr_and_flip(
    load_module: Any, psnr: float, flip: float, verdict: str
) -> None:
    peers, score = load_module("temporal_peers"), load_module("scores").Score
    image = np.zeros((2, 2, 3), np.float32)
    ours = peers.Compared("foliage", 16, "temporal", image, score(psnr, psnr), flip)
    theirs = peers.Compared("foliage", 16, "Open Image Denoise", image, score(36.0, 36.0), 0.05)
    assert f"**{verdict}**" in peers.verdict(ours, theirs)


def test_time_per_location_leaves_out_the_hierarchy_and_judges_foliage_only(load_module: Any) -> None:
    cost, timing = load_module("temporal_cost"), load_module("timing").Timing
    simple = cost.simple_scene(16, 16, 2)

    def of(name: str, judged: bool, views: float, tree_bytes: int) -> Any:
        work = cost.Workload(name, simple.samples, judged=judged)
        seconds = [timing([s], [s]) for s in (0.5, views, 3.0, 1.0)]
        return cost.Cost(work, 10**6, *seconds, tree_bytes, 10.0)

    samples = simple.samples.depth.size
    fast, slow = of("foliage", True, 0.75, 10 * samples), of("moving", False, 1.0, 40 * samples)
    assert (fast.microseconds, slow.microseconds) == (pytest.approx(0.25), pytest.approx(0.5))
    assert fast.bytes_per_sample == (32, 10)
    text = cost.verdict([fast, slow])
    assert "on foliage. **Met**; above it: moving (0.50)" in text
    assert "**Missed** on moving (72)" in text
    assert "**Missed**; above it: foliage" in cost.verdict([of("foliage", True, 1.0, 0)])


def test_discs_keep_their_size_and_shrink_without_overhang(load_module: Any) -> None:
    edges = load_module("temporal_edges")
    (outline,) = edges.measure_outlines(edges.CASES[1:2], [8])
    assert abs(outline.outside) < edges.TARGET
    assert outline.bare < outline.outside - 0.05
    assert outline.off >= abs(outline.outside)
    assert "**Met** on all discs" in edges.verdict([outline])


def test_missing_renders_through_the_disc_name_the_command(load_module: Any, tmp_path: Path) -> None:
    scenes = load_module("disc_scenes")
    (tmp_path / "serpent_disc_8spp.npz").touch()
    assert scenes.rendered(tmp_path, ["serpent"], 8) == []
    (tmp_path / "serpent_disc_reference.json").touch()
    assert scenes.rendered(tmp_path, ["serpent", "citadel"], 8) == ["serpent"]
    with pytest.raises(SystemExit, match=r"serpent --spp 4 .*--aperture disc"):
        scenes.load_disc_scene(tmp_path, "serpent", 4)


def test_without_the_overhang_the_rule_has_none_and_gets_it_back(load_module: Any) -> None:
    gains = load_module("temporal_gains")
    plan = importlib.import_module("fewrays.temporal.plan")
    before = plan._OVERHANG
    samples = load_module("temporal_cost").simple_scene(24, 24, 2).samples
    truth = load_module("example_renders").Reference(np.zeros((24, 24, 3), np.float32), 1, 90.0)
    scene = load_module("disc_scenes").DiscScene("leaves", samples, {"box": truth})
    scores = gains.measure_gains(
        [scene], [gains.Variant("as it is"), gains.Variant("none", overhang=False), gains.Variant("again")]
    )
    assert scores["as it is"] == scores["again"] != scores["none"]
    assert plan._OVERHANG == before > 0
    text = "\n".join(gains.section([scene], scores))
    assert "| again " in text
    assert "(+0.00)" in text
