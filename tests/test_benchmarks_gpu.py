"""The GPU's benchmark without a GPU: it says what is missing, and what it runs can be run."""

from __future__ import annotations

import importlib
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fewrays.cuda.device import find_device
from phases import PhasesMachine

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


class Event:
    """When it was recorded, by the clock."""

    seconds = 0.0

    def record(self) -> None:
        self.seconds = time.perf_counter()

    def synchronize(self) -> None:
        """Nothing is under way."""


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    pytest.importorskip("pyoidn")
    timing = importlib.import_module("gpu_timing")
    elapsed = lambda before, after: 1e3 * (after.seconds - before.seconds)  # noqa: E731
    cuda = SimpleNamespace(Event=Event, get_elapsed_time=elapsed)
    monkeypatch.setattr(timing, "_cupy", lambda: SimpleNamespace(cuda=cuda))
    return importlib.import_module("gpu")


@pytest.mark.skipif(not isinstance(find_device(), str), reason="there is a GPU")
def test_without_a_gpu_it_is_refused(gpu: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu.py", "--out", str(tmp_path)])
    with pytest.raises(SystemExit, match=r"there is none to use: (CuPy is not installed|no NVIDIA GPU)"):
        gpu.main()
    assert not list(tmp_path.iterdir())


def test_the_page_is_written(
    gpu: Any, phases: PhasesMachine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(gpu, "SIZES", ((18, 32),))
    monkeypatch.setattr(gpu, "LIT_SIZES", ((18, 32),))
    monkeypatch.setattr(gpu, "TARGETS", {"multiplane, build": {(18, 32): 1e9}})
    monkeypatch.setattr(gpu, "require_machine", lambda: phases)
    monkeypatch.setattr(gpu, "find_device", importlib.import_module("fewrays.cuda.device").find_device)
    monkeypatch.setattr(sys, "argv", ["gpu.py", "--repetitions", "2", "--sizes", "1", "--out", str(tmp_path)])
    gpu.main()
    page = (tmp_path / "gpu.md").read_text(encoding="utf-8")
    for text in (
        "32 x 18",
        "**Met**",
        "multiplane_evidence",
        "dynamic_synthesize",
        "temporal_resolve",
        "shadows_light",
        "GTX 680",
        "to the host",
    ):
        assert text in page
