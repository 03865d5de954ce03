# One word a task. PYTHON=... chooses the interpreter, best that of a virtual environment.
PYTHON ?= python3
CLANG_FORMAT ?= $(shell $(PYTHON) -c "import sysconfig; print(sysconfig.get_path('scripts'))")/clang-format
NATIVE := $(wildcard native/*.cpp native/*.h native/*/*.h native/*/*.cu)

.PHONY: install test slow test-gpu kernels lint types fmt asan bench bench-gpu demo clean

install:  # for development: an editable install with all tools
	$(PYTHON) -m pip install --editable ".[dev]"

test:
	$(PYTHON) -m pytest

slow:  # the long quality runs as well
	$(PYTHON) -m pytest --slow

test-gpu:  # what needs an NVIDIA GPU and the "cuda" extra; without a GPU it says so
	$(PYTHON) -m fewrays.cuda device
	$(PYTHON) -m pytest -m gpu

kernels:  # compile the GPU's kernels, which needs no GPU, and print what they take
	$(PYTHON) -m fewrays.cuda

lint:
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	$(CLANG_FORMAT) --dry-run --Werror $(NATIVE)

types:
	$(PYTHON) -m mypy

fmt:
	$(PYTHON) -m ruff check --fix-only
	$(PYTHON) -m ruff format
	$(CLANG_FORMAT) -i $(NATIVE)

asan:  # the tests once more, with the native code under the sanitizers
	PYTHON="$(PYTHON)" .ci/asan

bench:  # needs the "bench" extra
	$(PYTHON) benchmarks/quality.py
	$(PYTHON) benchmarks/speed.py
	$(PYTHON) benchmarks/robustness.py

bench-gpu:  # needs an NVIDIA GPU, and the extras "cuda" and "bench"
	$(PYTHON) benchmarks/gpu.py

demo:
	$(PYTHON) -m fewrays demo --out out

clean:
	rm -rf build dist out .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path "./.venv/*" -prune -exec rm -rf {} +
