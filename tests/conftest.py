"""What all tests share: the ``--slow`` option, how hard hypothesis looks, and Mitsuba where there is one."""

import os
from types import ModuleType

import pytest
from hypothesis import settings

from fewrays import SampleError
from fewrays.sources import mitsuba as source

settings.register_profile("quick", deadline=None, max_examples=40)
settings.register_profile("ci", settings.get_profile("quick"), derandomize=True)
settings.register_profile("thorough", settings.get_profile("quick"), max_examples=1000)
settings.load_profile("ci" if os.environ.get("CI") else "quick")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests that are marked slow as well")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--slow"):
        return
    skip = pytest.mark.skip(reason="slow: run with --slow")
    for item in items:
        if item.get_closest_marker("slow"):
            item.add_marker(skip)


@pytest.fixture(scope="module")
def mi() -> ModuleType:
    """Mitsuba with a working variant; skips where there is none."""
    module: ModuleType = pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    try:
        source.activate()
    except SampleError as error:
        pytest.skip(f"Mitsuba cannot run here: {error}")
    return module
