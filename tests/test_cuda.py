"""What all kernels for GPUs stand on: their text, their arguments, phases, and what is said without a GPU."""

from __future__ import annotations

import ctypes
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from fewrays import Lens, SampleError, defocus
from fewrays.cuda import device, nvrtc, source
from fewrays.cuda.kernel import Kernel
from fewrays.dynamic import cuda as dynamic_cuda
from fewrays.layered import cuda as layered_cuda
from fewrays.multiplane.cuda import assign as multiplane_assign
from fewrays.multiplane.cuda import build as multiplane_build
from fewrays.multiplane.cuda import render as multiplane_render
from fewrays.multiplane.cuda import smoothing as multiplane_smoothing
from fewrays.temporal import cuda as temporal_cuda
from fewrays.temporal import cuda_dispersion, cuda_mean, cuda_refine, relighting_cuda, shading_cuda
from phases import compile_phases

KERNELS = (
    *dynamic_cuda.KERNELS,
    *layered_cuda.KERNELS,
    *multiplane_assign.KERNELS,
    *multiplane_build.KERNELS,
    *multiplane_render.KERNELS,
    *multiplane_smoothing.KERNELS,
    *relighting_cuda.KERNELS,
    *shading_cuda.KERNELS,
    *temporal_cuda.KERNELS,
    *cuda_dispersion.KERNELS,
    *cuda_mean.KERNELS,
    *cuda_refine.KERNELS,
)

HAS_GPU = not isinstance(device.find_device(), str)


@pytest.mark.parametrize("program", source.PROGRAMS)
def test_texts_are_complete(program: str) -> None:
    text = source.program_text(program)
    assert "#include" not in text
    assert "#pragma once" not in text
    assert text.count("struct FrontRim {") <= 1
    assert "namespace std" in text


def test_every_kernel_is_described() -> None:
    """What Python says of a kernel's block and arguments is what C++ says."""
    described = {kernel.name for kernel in KERNELS}
    for program in source.PROGRAMS:
        text = (source.kernel_folder() / f"{program}.cu").read_text(encoding="utf-8")
        written = set(re.findall(r"^FEWRAYS_KERNEL(?:_WITH_\w+)?\((\w+),", text, re.MULTILINE))
        assert written == {kernel.name for kernel in KERNELS if kernel.program == program}
        assert written <= described


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
def test_arguments_lie_as_cpp_has_them(kernel: Kernel) -> None:
    library = compile_phases(kernel.program)
    assert getattr(library, f"{kernel.name}_threads")() == kernel.threads
    assert getattr(library, f"{kernel.name}_argument_bytes")() == kernel.layout.itemsize


@pytest.mark.parametrize("program", source.PROGRAMS)
def test_programs_compile_for_compute_capability_9(program: str) -> None:
    try:
        nvrtc.find_nvrtc()
    except SampleError as error:
        pytest.skip(str(error))
    found = nvrtc.compile_program(source.program_text(program), program, "sm_90", source.OPTIONS)
    assert {each.name for each in found} == {kernel.name for kernel in KERNELS if kernel.program == program}
    for each in found:
        assert each.shared_bytes <= 48 << 10
        assert each.spill_bytes == 0


def test_a_wrong_text_is_reported() -> None:
    try:
        nvrtc.find_nvrtc()
    except SampleError as error:
        pytest.skip(str(error))
    with pytest.raises(SampleError, match=r"wrong\.cu: does not compile for sm_90:\n.*undefined"):
        nvrtc.compile_program("__global__ void f() { g(); }", "wrong.cu")


def test_a_report_is_read() -> None:
    report = (
        "ptxas info    : Compiling entry function 'one' for 'sm_90'\n"
        "    16 bytes stack frame, 8 bytes spill stores, 4 bytes spill loads\n"
        "ptxas info    : Used 40 registers, used 1 barriers, 2048 bytes smem\n"
        "ptxas info    : Compiling entry function 'another' for 'sm_90'\n"
        "    0 bytes stack frame, 0 bytes spill stores, 0 bytes spill loads\n"
        "ptxas info    : Used 7 registers\n"
    )
    another, one = nvrtc.read_log(report)
    assert another == nvrtc.Resources("another", 7, 0, 0, 0)
    assert one == nvrtc.Resources("one", 40, 2048, 16, 12)


KERNEL = Kernel("none", "scale", 64, {"values": "*f4", "count": "i4", "factor": "f4", "rim": "3f4"})


def address(array: np.ndarray) -> int:
    return int(array.ctypes.data)


def test_arguments_are_packed_as_c_does() -> None:
    values = np.ones(5, np.float32)
    record = KERNEL.pack({"values": values, "count": 5, "factor": 2.5, "rim": (1, 2, 3)}, address)

    class Arguments(ctypes.Structure):
        _fields_ = (
            ("values", ctypes.c_void_p),
            ("count", ctypes.c_int32),
            ("factor", ctypes.c_float),
            ("rim", ctypes.c_float * 3),
        )

    seen = Arguments.from_buffer_copy(record.tobytes())
    assert ctypes.sizeof(Arguments) == KERNEL.layout.itemsize
    assert (seen.values, seen.count, seen.factor, list(seen.rim)) == (address(values), 5, 2.5, [1, 2, 3])


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"values": np.ones(5)}, "float32"),
        ({"values": np.ones((5, 2), np.float32)[:, 0]}, "not contiguous"),
        ({"surprise": 1}, "surprise"),
    ],
)
def test_wrong_arguments_are_refused(changes: dict[str, object], problem: str) -> None:
    good = {"values": None, "count": 5, "factor": 2.5, "rim": (1, 2, 3)}
    with pytest.raises(TypeError, match=problem):
        KERNEL.pack(good | changes, address)


RACE = """
#include "block.h"
namespace fewrays {
struct RaceArguments { int* values; int barrier; };
struct RaceShared { int values[32]; };
inline void run_race(const RaceArguments& a, const Block& block, RaceShared& shared) {
    block.each([&](int thread) { shared.values[thread] = thread; });
    if (a.barrier) {
        block.each([&](int thread) { a.values[thread] = shared.values[31 - thread]; });
    } else {
        block.each([&](int thread) {
            shared.values[thread] += 100;
            a.values[thread] = shared.values[31 - thread];
        });
    }
    const bool any = block.any([&](int thread) { return a.values[thread] == 7; });
    if (!any) block.each([&](int) { a.values[0] = -1; });
}
}  // namespace fewrays
FEWRAYS_KERNEL(race, 32, fewrays::RaceArguments, fewrays::RaceShared)
"""


def test_orders_of_threads_show_what_a_missing_barrier_does(tmp_path: Path) -> None:
    path, library = tmp_path / "race.cu", tmp_path / "race.so"
    path.write_text(RACE, encoding="utf-8")
    command = ["c++", "-std=c++20", "-fPIC", "-shared", f"-I{source.kernel_folder()}", "-x", "c++"]
    subprocess.run([*command, str(path), "-o", str(library)], check=True)
    run = ctypes.CDLL(str(library)).race

    def results(barrier: int) -> list[list[int]]:
        found = []
        for order in range(3):
            values = np.zeros(32, np.int32)
            record = np.array([(address(values), barrier)], np.dtype([("a", "u8"), ("b", "i4")], align=True))
            run(ctypes.c_void_p(address(record)), 1, 1, 1, order, 0)
            found.append(values.tolist())
        return found

    right, wrong = results(1), results(0)
    assert right[0] == right[1] == right[2] == list(range(31, -1, -1))
    assert not wrong[0] == wrong[1] == wrong[2]


@pytest.mark.skipif(HAS_GPU, reason="there is a GPU")
def test_without_a_gpu_that_is_said() -> None:
    picture = (np.ones((6, 8, 3)), np.full((6, 8), 3.0), Lens(-8.0, 4.0))
    with pytest.raises(SampleError, match=r"device: (CuPy is not installed.*fewrays\[cuda\]|no NVIDIA GPU)"):
        defocus(*picture, device="cuda")
    np.testing.assert_array_equal(defocus(*picture), defocus(*picture, device="cpu"))


def test_auto_takes_the_gpu_and_says_so_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    card = device.Device("a card", (9, 0), 80 << 30, 132, 227 << 10, 50 << 20)
    monkeypatch.setattr(device, "find_device", lambda: card)
    device.announce.cache_clear()
    assert device.pick_device(("cpu", "reference", "cuda"), "auto") == "cuda"
    assert device.pick_device(("cpu", "cuda"), "auto") == "cuda"
    assert device.pick_device(("cpu", "cuda"), "cpu") == "cpu"
    assert device.pick_device(("cpu", "reference"), "auto") == "cpu"
    device.announce.cache_clear()
    assert capsys.readouterr().err == "fewrays: running on a card; device='cpu' runs on the processor\n"
