"""Finding an LLVM that does not end the process; no Mitsuba needed, only file names."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path

import pytest

from fewrays import SampleError
from fewrays.sources import llvm
from fewrays.sources.llvm import find_llvm, llvm_version

VARIABLE = "DRJIT_LIBLLVM_PATH"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder that is the only place to look in, on an x86 Linux."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(llvm, "_FOLDERS", {"linux": (str(tmp_path),)})
    monkeypatch.delenv("CONDA_PREFIX", raising=False)
    monkeypatch.setenv(VARIABLE, "")  # so that monkeypatch takes back what find_llvm sets
    return tmp_path


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM.so.19.1", 19),
        ("libLLVM-19.so", 19),
        ("libLLVM-15.so.1", 15),
        ("libLLVM-14.0.6.so.1", 14),
        ("libLLVM-C.so.20.1", 20),
        ("libLLVM.so", None),
        ("libLLVM.so.1", None),
    ],
)
def test_version_from_the_name(tmp_path: Path, name: str, version: int | None) -> None:
    (tmp_path / name).write_bytes(b"not a library")
    assert llvm_version(tmp_path / name) == version


def test_version_follows_links(tmp_path: Path) -> None:
    (tmp_path / "libLLVM.so.18.1").write_bytes(b"")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.18.1")
    assert llvm_version(tmp_path / "libLLVM.so") == 18


def test_newest_library_wins(folder: Path) -> None:
    for name in ("libLLVM-15.so.1", "libLLVM.so.19.1", "libLLVM-17.so", "libLLVM.so"):
        (folder / name).write_bytes(b"")
    assert find_llvm() == folder / "libLLVM.so.19.1"
    assert os.environ[VARIABLE] == str(folder / "libLLVM.so.19.1")


def test_named_library_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("libLLVM.so.17.0", "libLLVM.so.20.1"):
        (folder / name).write_bytes(b"")
    monkeypatch.setenv(VARIABLE, str(folder / "libLLVM.so.17.0"))
    assert find_llvm() == folder / "libLLVM.so.17.0"


@pytest.mark.parametrize("named", [False, True])
def test_old_library_is_refused_on_x86(folder: Path, monkeypatch: pytest.MonkeyPatch, named: bool) -> None:
    old = folder / "libLLVM-15.so.1"
    old.write_bytes(b"")
    if named:
        monkeypatch.setenv(VARIABLE, str(old))
    with pytest.raises(SampleError, match=r"LLVM 15.*install LLVM 17 or newer.*DRJIT_LIBLLVM_PATH") as caught:
        find_llvm()
    assert caught.value.field == VARIABLE
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert find_llvm() == old


def test_no_library(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SampleError, match="found no LLVM shared library"):
        find_llvm()
    monkeypatch.setenv(VARIABLE, str(folder / "gone.so"))
    with pytest.raises(SampleError, match="does not exist"):
        find_llvm()


def test_unknown_release_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "libLLVM.so").write_bytes(b"not a library")
    monkeypatch.setenv(VARIABLE, str(folder / "libLLVM.so"))
    with pytest.raises(SampleError, match="cannot tell which LLVM"):
        find_llvm()


def test_other_systems_are_left_to_drjit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    del folder
    monkeypatch.setattr(sys, "platform", "win32")
    assert find_llvm() is None
