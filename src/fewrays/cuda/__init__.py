"""Reconstruction on NVIDIA GPUs.

`device` finds the card. `source` puts the text of kernels together from ``native/cuda`` and the scalar
headers that they share with the CPU's. `kernel` says what a kernel takes, `machine` what kernels run on, and
`cupy_machine` is the card, by CuPy: kernels are compiled for it on their first use and kept on disk. What the
methods do with all that is in their own packages (`fewrays.dynamic.cuda`).

Nothing here imports CuPy before a GPU is asked for. `nvrtc` compiles without a card, for
``python -m fewrays.cuda``, which prints what every kernel takes of a multiprocessor.
"""
