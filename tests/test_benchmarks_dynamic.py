"""The checks and verdicts behind the page of the dynamic method."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fewrays import Lens, save_image
from fewrays.dynamic import DepthLayer
from fewrays.io.rgbz import save_rgbz

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def load_module(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def test_missing_renders_name_the_command(load_module: Any, tmp_path: Path) -> None:
    scenes = load_module("dynamic_scenes")
    with pytest.raises(SystemExit, match=r"python examples/pinhole\.py serpent --views 12 24 36 48 64"):
        scenes.require_pinhole_renders(tmp_path, ["serpent"])
    for file in scenes._pinhole_files(tmp_path, "serpent"):
        file.touch()
    with pytest.raises(SystemExit, match=r"python examples/render\.py serpent --aperture disc"):
        scenes.require_pinhole_renders(tmp_path, ["serpent"])
    (tmp_path / "serpent_disc_reference.json").touch()
    scenes.require_pinhole_renders(tmp_path, ["serpent"])


def test_scenes_come_with_their_lens(load_module: Any, tmp_path: Path) -> None:
    scenes = load_module("dynamic_scenes")
    layer = DepthLayer(np.ones((4, 5, 3), np.float32), np.full((4, 5), 2.0, np.float32))
    front, behind, *accumulated = scenes._pinhole_files(tmp_path, "serpent")
    save_rgbz(behind, layer)
    for file in [*accumulated, *(tmp_path / f"serpent_disc_reference_{f}.exr" for f in ("box", "gaussian"))]:
        save_image(file, layer.color)
    record = '{"spp": 16, "noise_psnr_gamma22_db": {"box": 40.0, "gaussian": 41.0}}'
    (tmp_path / "serpent_disc_reference.json").write_text(record)
    save_rgbz(front, layer, lens=(-30.0, 10.0))
    scene = scenes.load_pinhole_scene(tmp_path, "serpent")
    assert scene.lens == Lens(-30.0, 10.0)
    assert scene.reference.noise_psnr == 40.0
    assert tuple(scene.accumulated) == scenes.VIEWS
    save_rgbz(front, layer)
    with pytest.raises(SystemExit, match="has no lens in its header"):
        scenes.load_pinhole_scene(tmp_path, "serpent")


@pytest.mark.parametrize(
    ("few", "many", "fast", "linear"),
    [(24.0, 20.0, "Met", "Met"), (26.0, 20.0, "Missed", "Met"), (20.0, 23.0, "Met", "Missed")],
)
def test_time_is_judged_per_pixel_and_view(
    load_module: Any, few: float, many: float, fast: str, linear: str
) -> None:
    cost = load_module("dynamic_cost")
    work = cost.leaves(20, 30)
    pixels = work.layers[0].depth.size
    costs = [
        cost.Cost(work, views, 1.0, 0.75 * ns * pixels * views / 1e9, 0.25 * ns * pixels * views / 1e9)
        for views, ns in ((12, few), (64, many))
    ]
    assert [each.nanoseconds for each in costs] == pytest.approx([few, many])
    text = cost.verdict([costs])
    assert f"per pixel and view. **{fast}**: {max(few, many):.1f} at most" in text
    assert f"linear in views. **{linear}**: a view costs {many / few:.2f} times" in text


def test_timed_calls_report_every_stage(load_module: Any) -> None:
    cost = load_module("dynamic_cost")
    costs = cost.measure_cost(cost.leaves(24, 32), 1)
    assert [each.views for each in costs] == list(load_module("dynamic_scenes").VIEWS)
    assert all(each.warping > 0 and each.synthesis > 0 and each.preparation > 0 for each in costs)


def test_enlarged_scenes_blur_by_as_many_more_pixels(load_module: Any) -> None:
    cost, scenes = load_module("dynamic_cost"), load_module("dynamic_scenes")
    rng = np.random.default_rng(0)
    color, depth, alpha = rng.uniform(1, 5, (3, 3, 4, 1)).astype(np.float32)
    layer = DepthLayer(color.repeat(3, axis=-1), depth[..., 0], alpha[..., 0] / 5)
    scene = scenes.PinholeScene("small", layer, layer, Lens(-9.0, 3.0), None, {})
    work = cost.enlarged(scene, 2, both=True)
    assert len(work.layers) == 2
    assert work.layers[0].depth.shape == (6, 8)
    np.testing.assert_array_equal(
        work.lens.slope(work.layers[1].depth[::2, 1::2]), 2 * scene.lens.slope(layer.depth)
    )


def test_the_method_is_compared_with_every_rival(load_module: Any) -> None:
    quality = load_module("dynamic_quality")
    views = load_module("dynamic_scenes").VIEWS
    psnr = dict(zip((quality._GATHER, quality._ACCUMULATED, quality._PUBLISHED), (30, 33, 31), strict=True))
    psnr |= {quality._PINHOLE: 20, quality._ONE: 34, quality._TWO: 35.5}
    by_name = {name: dict.fromkeys(views, quality.Quality(float(p), 0.1)) for name, p in psnr.items()}
    text = quality.verdict({"leaves": by_name})
    assert "+4.00 dB against blur by circle of confusion, +1.00 dB against pinhole renders" in text
    assert "+3.00 dB against dynamic, as published; +1.50 dB with the layer behind" in text
