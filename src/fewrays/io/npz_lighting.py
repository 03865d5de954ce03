"""Area lights and their samples in the native format.

Members are named as the fields are: ``lighting.normal`` for `Lighting.normal`, ``lighting.projection.focal``,
``light0.lxy`` for the first light's samples, ``light0.light.center`` for the light itself. The numbers of
projections and lights are float64, the arrays float32.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from fewrays.errors import SampleError
from fewrays.io.formats import StoredLight, StoredLighting
from fewrays.io.npy_header import ArrayHeader
from fewrays.io.npz_archive import NpzArchive
from fewrays.lighting import MAX_LIGHTS, Lighting, LightSamples

__all__ = ["LightingReader", "lighting_members"]

_OWN = "lighting."
_PROJECTION = ("focal", "center")
_VECTORS = ("center", "half_u", "half_v", "motion")
_NUMBERED = re.compile(r"light([0-9]{1,4})\.")


def lighting_members(lighting: Lighting) -> tuple[dict[str, npt.NDArray[Any]], dict[str, npt.NDArray[Any]]]:
    """Return what there is to write: small members, and arrays of samples, by name."""
    small = {f"{_OWN}projection.{name}": np.array(getattr(lighting.projection, name)) for name in _PROJECTION}
    arrays = {_OWN + name: getattr(lighting, name) for name in lighting.field_names()}
    for number, each in enumerate(lighting.lights):
        prefix = _prefix(number)
        for name in (*_VECTORS, "shape", "plane_distance"):
            small[f"{prefix}light.{name}"] = np.array(getattr(each.light, name))
        arrays |= {prefix + name: getattr(each, name) for name in each.field_names()}
    return small, arrays


class LightingReader:
    """Reads an archive's lighting in two steps: what can be checked first, then the arrays.

    Parameters
    ----------
    archive : NpzArchive
        The archive.

    Raises
    ------
    SampleError
        For members that are missing, of the wrong type or shape, or larger than the file.
    """

    def __init__(self, archive: NpzArchive) -> None:
        self._archive = archive
        count = _count_lights(archive)
        self.present = count > 0 or any(name.startswith(_OWN) for name in archive.names())
        self._headers: dict[str, dict[str, ArrayHeader]] = {}
        if not self.present:
            return
        self._headers[_OWN] = archive.headers(Lighting.CHANNELS, prefix=_OWN)
        self._projection = {name: archive.numbers(f"{_OWN}projection.{name}", 2) for name in _PROJECTION}
        self._lights = [_read_light(archive, _prefix(number)) for number in range(count)]
        for number in range(count):
            prefix = _prefix(number)
            self._headers[prefix] = archive.headers(
                LightSamples.CHANNELS, optional=("motion",), prefix=prefix
            )

    @property
    def count(self) -> int:
        """Number of arrays to read."""
        return sum(len(headers) for headers in self._headers.values())

    def read(self, bar: tqdm[Any]) -> StoredLighting | None:
        """Read the arrays; None if the file has no lighting."""
        if not self.present:
            return None
        own, *lights = (
            self._archive.arrays(headers, bar, prefix=prefix) for prefix, headers in self._headers.items()
        )
        stored = [StoredLight(*each) for each in zip(self._lights, lights, strict=True)]
        return StoredLighting(self._projection, own, stored)


def _prefix(number: int) -> str:
    return f"light{number}."


def _count_lights(archive: NpzArchive) -> int:
    """Return how many lights have members; they are numbered without gaps."""
    found = {int(match[1]) for match in map(_NUMBERED.match, archive.names()) if match}
    if len(found) > MAX_LIGHTS:
        raise SampleError(f"holds {len(found)} lights; at most {MAX_LIGHTS} are possible", field="lighting")
    for number in range(len(found)):
        if number not in found:
            raise SampleError(
                f"is missing although there is light{max(found)}; lights are numbered from 0",
                field=f"light{number}",
            )
    return len(found)


def _read_light(archive: NpzArchive, prefix: str) -> Mapping[str, Any]:
    """Return the fields of an `AreaLight`; what has a default may be missing."""
    fields: dict[str, Any] = {}
    for name in _VECTORS:
        if name != "motion" or f"{prefix}light.motion" in archive:
            fields[name] = archive.numbers(f"{prefix}light.{name}", 3)
    if f"{prefix}light.shape" in archive:
        fields["shape"] = archive.text(f"{prefix}light.shape")
    if f"{prefix}light.plane_distance" in archive:
        fields["plane_distance"] = archive.number(f"{prefix}light.plane_distance")
    return fields
