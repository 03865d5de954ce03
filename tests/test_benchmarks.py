"""The arithmetic and the checks behind the benchmarks' pages."""

import importlib
import math
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
    quality = load_module("quality")
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.2, 0.8, 400_000)
    image = truth + rng.normal(0, 0.02, truth.shape)
    reference = truth + rng.normal(0, 0.01, truth.shape)

    def psnr(a: Any, b: Any) -> float:
        return float(-10 * np.log10(np.square(a - b).mean()))

    corrected = quality.without_noise(psnr(image, reference), psnr(reference, truth))
    assert corrected == pytest.approx(psnr(image, truth), abs=0.05)


def test_an_error_that_noise_explains_counts_as_none(load_module: Any) -> None:
    assert load_module("quality").without_noise(40.0, 39.9) == math.inf


def test_a_target_counts_as_missed_on_the_scenes_below_it(load_module: Any) -> None:
    quality = load_module("quality")
    margins = {"near": quality.Margin(5.1, 4.9), "far": quality.Margin(3.0, 3.5)}
    text = quality.verdict("minus peer", 5.0, margins)
    assert "**Missed** on far (+3.00 dB)" in text
    assert "the answer differs for near" in text
    assert "**Met**" in quality.verdict("minus peer", 3.0, margins)


def test_every_method_is_compared_under_its_own_pixel_filter(load_module: Any) -> None:
    quality = load_module("quality")
    methods = importlib.import_module("fewrays").METHODS
    filters = {name: quality.pixel_filter_of(method) for name, method in methods.items()}
    assert filters.pop("box") == "box"
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
    timings = load_module("speed").time_in_turns(calls, 2)
    assert order == ["a", "b"] * 3
    assert [len(timing.cpu) for timing in timings] == [len(timing.wall) for timing in timings] == [2, 2]
