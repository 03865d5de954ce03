"""What methods take on an NVIDIA GPU: medians of event-timed runs, stage by stage, beside the denoiser.

    python benchmarks/gpu.py

Needs a GPU and ``fewrays[cuda,bench]``. Writes ``docs/gpu.md``. Without a GPU it says what is missing and
writes nothing. Samples are on the card before the clock starts; transfers are timed apart.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import fewrays
from fewrays.cuda.device import Device, find_device, require_machine
from fewrays.cuda.machine import Machine
from fewrays.cuda.samples import DeviceSamples
from fewrays.dynamic import DefocusOptions, DepthLayer, DeviceLayer
from fewrays.dynamic import cuda as dynamic
from fewrays.dynamic.cuda_prepare import prepare_sheets
from fewrays.dynamic.plan import ViewRules
from fewrays.layered import LayeredOptions
from fewrays.layered import cuda as layered
from fewrays.lens import Lens
from fewrays.multiplane import MultiplaneOptions
from fewrays.multiplane.cuda.build import build_planes
from fewrays.multiplane.cuda.render import render_planes
from fewrays.sources.analytic_pinhole import pinhole
from fewrays.temporal import TemporalOptions, make_plan_on_card, reconstruct_on_card
from fewrays.temporal.cuda import reconstruct_bands
from fewrays.temporal.relighting_cuda import Relighting
from fewrays.temporal.shading import shading_on
from gpu_timing import DenoiserOnGpu, TimedMachine, milliseconds
from report import markdown_table, met, provenance, write_page
from workloads import LEAF_LENS, leaf_planes, leaf_stack, lit_ground, repeated

SIZES = ((720, 1280), (1080, 1920), (2160, 3840))
SPP = 8
LIT_SPP = 4
LIT_SIZES = SIZES[:2]  # larger ones take the host minutes to sample
TARGETS = {  # milliseconds on an H100, samples on the card
    "multiplane, build": {(720, 1280): 3.0},
    "multiplane, 128 views": {(720, 1280): 4.0},
    "multiplane, 64 views": {(2160, 3840): 1000 / 30},
    "dynamic, 36 views": {(1080, 1920): 0.6},
    "layered": {(720, 1280): 1.0, (2160, 3840): 1000 / 60},
    "temporal, 128 locations": {(720, 1280): 60.0},
}
PUBLISHED = {
    "layered": "31 to 76 ms on a GTX 680, as its paper has it (Vaidyanathan et al. 2015)",
    "temporal": "12.7 to 22.3 s on a GTX 680, as the same paper measured it (Lehtinen et al. 2011)",
}

SHADING = f"shading, {LIT_SPP} spp, 2 lamps, 128 light points"
RELIGHTING = f"temporal, {LIT_SPP} spp, 2 lamps, light at 128 locations"

Size = tuple[int, int]
Rows = dict[str, dict[Size, list[float]]]


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=20, help="runs that count, of each")
    parser.add_argument("--sizes", type=int, default=len(SIZES), choices=(1, 2, 3), help="the smallest first")
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder of the page")
    options = parser.parse_args()
    device = find_device()
    if isinstance(device, str):
        raise SystemExit(f"benchmarks/gpu.py measures on a GPU, and there is none to use: {device}")
    rows: Rows = {}
    stages: dict[str, dict[Size, dict[str, float]]] = {}
    for size in SIZES[: options.sizes]:
        print(f"{size[1]} x {size[0]}", file=sys.stderr)
        measure_size(size, options.repetitions, rows, stages)
    sections = [*introduction(device), times_section(rows), *stages_section(stages), peers_section()]
    write_page(options.out / "gpu.md", *sections, provenance("python benchmarks/gpu.py"))
    print(options.out / "gpu.md")


def measure_size(
    size: Size, repetitions: int, rows: Rows, stages: dict[str, dict[Size, dict[str, float]]]
) -> None:
    """Measure everything at one size."""
    machine = require_machine()
    on_host = samples_of(size)
    samples = DeviceSamples.of_buffer(machine, on_host)
    timed = TimedMachine(machine)
    build = MultiplaneOptions()
    planes = build_planes(machine, samples, build)
    image = render_planes(machine, planes, None, build)
    box = np.ascontiguousarray(fewrays.reconstruct(on_host, "box"))
    denoiser = DenoiserOnGpu(box)
    fields = (samples.xy, samples.uv, samples.depth, samples.color)
    copies = [(machine.xp.empty_like(each), each) for each in fields]

    def copy_samples() -> None:
        for to, source in copies:
            to[...] = source

    def views(count: int) -> Callable[[], object]:
        options = MultiplaneOptions(views=count)
        return lambda: render_planes(timed, planes, None, options)

    runs: dict[str, Callable[[], object]] = {
        "multiplane, build": lambda: build_planes(timed, samples, build),
        "multiplane, 128 views": views(128),
        "multiplane, 64 views": views(64),
        **dynamic_runs(timed, size),
        "layered": lambda: layered.reconstruct_image(timed, samples, LayeredOptions()),
        **temporal_runs(timed, samples),
        **(lit_runs(timed, lit_ground(*size, LIT_SPP)) if size in LIT_SIZES else {}),
        "copy of the samples on the card": copy_samples,
        "samples to the card": lambda: DeviceSamples.of_buffer(machine, on_host),
        "image to the host": lambda: machine.on_host(image),
    }
    for name, run in runs.items():
        timed.clear()
        rows.setdefault(name, {})[size] = milliseconds(run, repetitions)
        if timed.kernels:
            stages.setdefault(name, {})[size] = timed.medians(repetitions)
    if denoiser.available:
        rows.setdefault("Open Image Denoise, on the card", {})[size] = denoiser.milliseconds(repetitions)


def dynamic_runs(machine: Machine, size: Size) -> dict[str, Callable[[], object]]:
    """Return depth of field for a picture that is on the card, in parts and as a whole."""
    lens = Lens(LEAF_LENS.c0, LEAF_LENS.c1)
    options = DefocusOptions(views=36)
    rules = ViewRules.of_options(options, lens, *size)
    layers = [DeviceLayer.of_layer(machine, picture_of(size, lens))]
    sheets = prepare_sheets(machine, layers, lens, options)
    dynamic.blur_between_views(machine, sheets, rules)
    return {
        "dynamic, sheets": lambda: prepare_sheets(machine, layers, lens, options),
        "dynamic, 36 views": lambda: dynamic.synthesize_views(machine, sheets, rules),
        "dynamic, from picture to image": lambda: dynamic.defocus_layers(machine, layers, lens, options),
    }


def temporal_runs(machine: Machine, samples: DeviceSamples) -> dict[str, Callable[[], object]]:
    """Return the temporal method as a whole, and without what comes before and after its views."""
    options = TemporalOptions(locations=128)
    plan = make_plan_on_card(machine, samples, options, timed=False)
    return {
        "temporal, 128 locations": lambda: reconstruct_on_card(machine, samples, options, timed=False),
        "temporal, 128 views alone": lambda: reconstruct_bands(machine, samples, plan),
    }


def lit_runs(machine: Machine, samples: fewrays.SampleBuffer) -> dict[str, Callable[[], object]]:
    """Return light of lamps at samples and at locations, whose views are those of the temporal method."""
    assert samples.lighting is not None
    shading = shading_on(machine, samples)
    options = TemporalOptions(locations=128, light_at="locations")
    on_card = DeviceSamples.of_buffer(machine, samples)
    plan = make_plan_on_card(machine, on_card, options, timed=False, lighting=samples.lighting)
    relighting = Relighting(machine, samples, on_card, plan, samples.lighting)
    return {
        SHADING: shading.run,
        RELIGHTING: lambda: reconstruct_bands(machine, on_card, plan, relighting),
    }


def samples_of(size: Size) -> fewrays.SampleBuffer:
    """Return planes of leaves, drawn once at a third of 4K and repeated beyond."""
    height, width = size
    if size == (2160, 3840):
        return repeated(leaf_planes(720, 1280, SPP), 3)
    return leaf_planes(height, width, SPP)


def picture_of(size: Size, lens: Lens) -> DepthLayer:
    """Return a picture of leaves with depth."""
    height, width = size
    small = (720, 1280) if size == (2160, 3840) else size
    layer = pinhole(leaf_stack(*small), lens, *small, spp=4)
    if small != size:
        layer = DepthLayer(np.tile(layer.color, (3, 3, 1)), np.tile(layer.depth, (3, 3)))
    assert layer.depth.shape == (height, width)
    return layer


def introduction(device: Device) -> Iterator[str]:
    """Say what was measured, and on what."""
    yield "# Times on a GPU"
    yield (
        f"Milliseconds between events before and behind each run, medians and, in brackets, ranges, on "
        f"{device.name} ({device.multiprocessors} multiprocessors, {device.cache_bytes >> 20} MiB of shared "
        f"cache). Planes of leaves at {SPP} samples per pixel, which are on the card before the clock "
        "starts; runs take the memory that earlier ones have returned to the pool. What is shaded are balls "
        "and boxes on the ground, whose hierarchies are there as well. Made by a benchmark, not by hand."
    )


def times_section(rows: Rows) -> str:
    """Return the table of times."""
    sizes = list(next(iter(rows.values())))
    head = ["", *(f"{width} x {height}" for height, width in sizes), "target"]
    table = []
    for name, by_size in rows.items():
        cells = [spread_of(by_size[size]) if size in by_size else "" for size in sizes]
        verdicts = [
            f"{limit:.3g} ms at {size[1]} x {size[0]}: {met(statistics.median(by_size[size]) <= limit)}"
            for size, limit in TARGETS.get(name, {}).items()
            if size in by_size
        ]
        table.append([name, *cells, "; ".join(verdicts)])
    return markdown_table(head, table)


def stages_section(stages: dict[str, dict[Size, dict[str, float]]]) -> Iterator[str]:
    """Return where the time goes, kernel by kernel."""
    yield "## Stages"
    yield "Milliseconds of each kernel in a run, all its launches together; what is left is the host's part."
    for name, by_size in stages.items():
        head = [name, *(f"{width} x {height}" for height, width in by_size)]
        kernels = dict.fromkeys(kernel for found in by_size.values() for kernel in found)
        yield markdown_table(
            head,
            [[each, *(f"{found.get(each, 0):.3f}" for found in by_size.values())] for each in kernels],
        )


def peers_section() -> str:
    """Return what others say of theirs."""
    lines = [f"- *{name}*: {text}" for name, text in PUBLISHED.items()]
    return "\n".join(["Published times of other implementations, on other cards:", "", *lines])


def spread_of(times: list[float]) -> str:
    """Return median and range."""
    return f"{statistics.median(times):.3f} ({min(times):.3f} to {max(times):.3f})"


if __name__ == "__main__":
    main()
