"""Options that nobody knows are refused by name, along with those that there are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from buffers import random_buffer
from fewrays import Lens, SampleError, defocus, load, reconstruct, save
from fewrays.errors import require_known_options

LENS = Lens(-4.0, 1.0)
SAMPLES = random_buffer(4, 5, 1, LENS)
DEPTH = np.full((4, 5), 4.0)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: reconstruct(SAMPLES, "layered", typo=1), "method 'layered'; there are sigma_pix, "),
        (lambda: reconstruct(SAMPLES, "multiplane", typo=1), "method 'multiplane'; there are .*views"),
        (lambda: defocus(np.ones((4, 5, 3)), DEPTH, LENS, typo=1), "defocus; there are .*views"),
        (lambda: save(Path("a.npz"), SAMPLES, typo=1), "npz files; there are compressed, half$"),
        (lambda: load(Path("a.npz"), typo=1), "npz files; there are "),
    ],
)
def test_unknown_options_are_refused(call: Callable[[], object], named: str) -> None:
    with pytest.raises(SampleError, match=rf"^typo: no such option for {named}") as caught:
        call()
    assert caught.value.field == "typo"


def test_what_takes_no_options_says_so() -> None:
    with pytest.raises(SampleError, match=r"^a: no such option for b; there are none$"):
        require_known_options(["a"], (), "b")
    require_known_options(["a"], ("b", "a"), "c")
