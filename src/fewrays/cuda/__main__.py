"""``python -m fewrays.cuda``: compile every kernel without a card and print what each takes.

``python -m fewrays.cuda device`` prints the card, or why there is none to use.
"""

from __future__ import annotations

import sys

from fewrays.cuda.device import find_device
from fewrays.cuda.nvrtc import compile_program
from fewrays.cuda.source import OPTIONS, PROGRAMS, program_text
from fewrays.errors import SampleError


def main() -> int:
    """Compile for compute capability 9.0, or for those given as arguments, such as ``sm_70``."""
    if sys.argv[1:] == ["device"]:
        device = find_device()
        print(device if not isinstance(device, str) else f"fewrays: {device}")
        return int(isinstance(device, str))
    print(f"{'kernel':32}{'target':>8}{'registers':>11}{'shared':>9}{'stack':>7}{'spills':>8}")
    try:
        for architecture in sys.argv[1:] or ["sm_90"]:
            for program in PROGRAMS:
                for found in compile_program(program_text(program), f"{program}.cu", architecture, OPTIONS):
                    print(
                        f"{found.name:32}{architecture:>8}{found.registers:>11}{found.shared_bytes:>9}"
                        f"{found.stack_bytes:>7}{found.spill_bytes:>8}"
                    )
    except SampleError as error:
        print(f"fewrays: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
