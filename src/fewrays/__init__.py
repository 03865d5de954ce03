"""fewrays: noise-free depth of field, motion blur and soft shadows from a few rays per pixel."""

from fewrays.dynamic import defocus
from fewrays.errors import SampleError
from fewrays.io import load, load_image, save, save_image
from fewrays.lens import Lens
from fewrays.lighting import AreaLight, Lighting, LightSamples, Projection
from fewrays.metrics import compare
from fewrays.multiplane import Multiplane
from fewrays.reconstruct import METHODS, reconstruct
from fewrays.samples import SampleBuffer
from fewrays.temporal.shading import shade

__all__ = [
    "METHODS",
    "AreaLight",
    "Lens",
    "LightSamples",
    "Lighting",
    "Multiplane",
    "Projection",
    "SampleBuffer",
    "SampleError",
    "compare",
    "defocus",
    "load",
    "load_image",
    "reconstruct",
    "save",
    "save_image",
    "shade",
]

__version__ = "0.1.0"
