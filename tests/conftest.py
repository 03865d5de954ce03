"""What all tests share: which are left out, how hard hypothesis looks, and Mitsuba where there is one."""

import os
from types import ModuleType

import pytest
from hypothesis import settings

from fewrays import SampleError
from fewrays.cuda.device import Device, find_device
from fewrays.sources import mitsuba as source
from phases import PhasesMachine

settings.register_profile("quick", deadline=None, max_examples=40)
settings.register_profile("ci", settings.get_profile("quick"), derandomize=True)
settings.register_profile("thorough", settings.get_profile("quick"), max_examples=1000)
settings.load_profile("ci" if os.environ.get("CI") else "quick")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests that are marked slow as well")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    missing = {} if config.getoption("--slow") else {"slow": "slow: run with --slow"}
    if any(item.get_closest_marker("gpu") for item in items) and isinstance(no_gpu := find_device(), str):
        missing["gpu"] = no_gpu
    for item in items:
        for marker, reason in missing.items():
            if item.get_closest_marker(marker):
                item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="module")
def mi() -> ModuleType:
    """Mitsuba with a working variant; skips where there is none."""
    module: ModuleType = pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    try:
        source.activate()
    except SampleError as error:
        pytest.skip(f"Mitsuba cannot run here: {error}")
    return module


@pytest.fixture
def phases(monkeypatch: pytest.MonkeyPatch) -> PhasesMachine:
    """A machine that stands for a GPU, and that the package finds when it looks for one."""
    machine = PhasesMachine()
    card = Device("phases on the processor", (9, 0), 1 << 30, 1, machine.shared_bytes, machine.cache_bytes)
    monkeypatch.setattr("fewrays.cuda.device.find_device", lambda: card)
    for module in (
        "fewrays.cuda.samples",
        "fewrays.dynamic",
        "fewrays.dynamic.device_layer",
        "fewrays.layered",
        "fewrays.multiplane.engine",
        "fewrays.temporal",
        "fewrays.temporal.shading",
    ):
        monkeypatch.setattr(f"{module}.require_machine", lambda: machine)
    return machine
