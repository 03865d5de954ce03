"""The variants of Mitsuba that its source runs on: which one to take, and whether it can work here."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from types import ModuleType
from typing import Any

from fewrays.errors import SampleError
from fewrays.sources.llvm import find_llvm

__all__ = ["VARIANTS", "activate", "active_variant"]

VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")
"""The Mitsuba variants that this source runs on."""


def activate(variant: str | None = None) -> str:
    """Activate a Mitsuba variant that this source runs on, after making sure that it can work.

    `render` does so by itself. Call this before building scenes from Mitsuba objects such as transforms.

    Parameters
    ----------
    variant : {"llvm_ad_rgb", "cuda_ad_rgb"}, optional
        The active variant where it is one of these; otherwise CUDA where there is a GPU, else LLVM.

    Returns
    -------
    str
        The variant that is now active.

    Raises
    ------
    SampleError
        For an unknown variant, and when there is no LLVM library that Mitsuba can use.
    ImportError
        When Mitsuba is not installed.
    """
    mi = _import_mitsuba()
    active = mi.variant()
    wanted = _default_variant(mi, active) if variant is None else variant
    if wanted not in VARIANTS:
        raise SampleError(f"expected one of {', '.join(VARIANTS)}; got {wanted!r}", field="variant")
    if wanted not in mi.variants():
        raise SampleError(
            f"this build of Mitsuba has no {wanted}; it has {', '.join(mi.variants())}", field="variant"
        )
    if wanted != active:
        if wanted.startswith("llvm"):
            find_llvm()
        mi.set_variant(wanted)
    return wanted


@contextlib.contextmanager
def active_variant(wanted: str | None, scene: Any) -> Iterator[ModuleType]:
    """Activate a variant, and bring back the caller's afterwards."""
    mi = _import_mitsuba()
    before = mi.variant()
    chosen = activate(wanted)
    try:
        owner = getattr(scene, "variant_name", None)
        if callable(owner) and owner() != chosen:
            raise SampleError(
                f"the scene was loaded under {owner()}: load it after mitsuba.set_variant({chosen!r})",
                field="scene",
            )
        yield mi
    finally:
        if before not in (None, chosen):
            mi.set_variant(before)


def _import_mitsuba() -> ModuleType:
    try:
        import mitsuba as mi
    except ImportError as error:
        raise ImportError('mitsuba is not installed; pip install "fewrays[mitsuba]" provides it') from error
    module: ModuleType = mi
    return module


def _default_variant(mi: ModuleType, active: str | None) -> str:
    if active in VARIANTS:
        return str(active)
    if "cuda_ad_rgb" in mi.variants():
        import drjit as dr

        if dr.has_backend(dr.JitBackend.CUDA):
            return "cuda_ad_rgb"
    return "llvm_ad_rgb"
