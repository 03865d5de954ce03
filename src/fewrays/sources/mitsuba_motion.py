"""Moving shapes for Mitsuba, which has no motion blur of its own.

The shutter interval is cut into thin slices. `MovingShapes.pose` puts the shapes where they are in the middle
of a slice, all samples of that slice are traced together, and `MovingShapes.displacement` tells how far the
point that each of them hit travels while the shutter is open.

Every point moves along a straight line at constant speed, from where the scene has it (the shutter opens) to
where the caller wants it (the shutter closes): what *temporal* (section 3.1) assumes of a sample. A rotation
turns into chords that way; over 30 degrees a shape shrinks by 3.4 % halfway.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError

__all__ = ["MovingShapes", "registry_numbers"]

Float64 = npt.NDArray[np.float64]
UInt32 = npt.NDArray[np.uint32]

_MAX_LISTED = 12


class MovingShapes:
    """Those shapes of a loaded scene that move, and where to.

    Parameters
    ----------
    mi : module
        Mitsuba, with the variant active that the scene was loaded under.
    scene : mitsuba.Scene
        As it stands when the shutter opens.
    motion : mapping
        By identifier of the shape: a 4 x 4 affine transform in world space from the shape's place when the
        shutter opens to its place when it closes, or the vertices' positions (N, 3) when it closes.

    Raises
    ------
    SampleError
        For identifiers that the scene does not have, shapes that cannot move, and transforms or positions
        that are of another shape, not finite, or not affine.
    """

    def __init__(self, mi: ModuleType, scene: Any, motion: Mapping[str, Any]) -> None:
        self._mi = mi
        self._parameters = mi.traverse(scene)
        shapes = {shape.id(): shape for shape in scene.shapes() if shape.id()}
        self._time = 0.0
        self._movers = [_mover(mi, shapes, self._parameters, name, end) for name, end in motion.items()]

    @contextmanager
    def posing(self) -> Iterator[None]:
        """Allow `pose`, and put everything back afterwards."""
        try:
            yield
        finally:
            for mover in self._movers:
                mover.restore(self._parameters)
            self._parameters.update()

    def pose(self, time: float) -> None:
        """Put the shapes where they are at a time from 0 to 1 over the shutter interval."""
        for mover in self._movers:
            mover.pose(self._parameters, time)
        self._parameters.update()
        self._time = time

    def end_points(self) -> Float64:
        """World positions (N, 3) whose bounding box holds all moving shapes when the shutter closes."""
        return np.concatenate([mover.end_points() for mover in self._movers])

    def shift_of(self, shape: Any) -> Float64:
        """Return by how much (3,) a shape that is no mesh is shifted over the shutter, in world space.

        It is 0 for what does not move.

        Raises
        ------
        SampleError
            For a shape that moves in any other way.
        """
        number = int(registry_numbers(self._mi, self._mi.ShapePtr(shape))[0])
        for mover in self._movers:
            if isinstance(mover, _MovingPose) and mover.registry == number:
                return mover.shift()
        return np.zeros(3)

    def displacement(self, hit: Any, ray: Any) -> Float64:
        """Return how far the points travel that rays hit in the present pose.

        Parameters
        ----------
        hit : mitsuba.PreliminaryIntersection3f
            Of N rays.
        ray : mitsuba.Ray3f
            Those rays.

        Returns
        -------
        ndarray, (N, 3)
            Change of position over the whole shutter interval in world space; 0 for what does not move.
        """
        import drjit as dr

        mi = self._mi
        owner = registry_numbers(mi, dr.select(hit.instance != mi.ShapePtr(None), hit.instance, hit.shape))
        owner = np.where(np.asarray(hit.is_valid()), owner, 0)
        travelled = np.zeros((len(owner), 3))
        for mover in self._movers:
            found = np.flatnonzero(owner == mover.registry)
            if len(found):
                travelled[found] = mover.displacement(hit, ray, found, self._time)
        return travelled


class _Mover(ABC):
    """One shape that moves: its number in Dr.Jit's registry, and the parameters that place it."""

    registry: int

    @abstractmethod
    def pose(self, parameters: Any, time: float) -> None:
        """Set the parameters for a time from 0 to 1; the caller updates the scene."""

    @abstractmethod
    def restore(self, parameters: Any) -> None:
        """Set the parameters as they were at first."""

    @abstractmethod
    def end_points(self) -> Float64:
        """World positions whose bounding box holds the shape when the shutter closes."""

    @abstractmethod
    def displacement(self, hit: Any, ray: Any, found: npt.NDArray[np.intp], time: float) -> Float64:
        """World motion (K, 3) over the shutter interval of those K hits, which are on this shape."""


class _MovingMesh(_Mover):
    """A triangle mesh: its vertices travel, and its shading normals turn along."""

    def __init__(self, mi: ModuleType, shape: Any, parameters: Any, name: str, end: Float64) -> None:
        self._mi, self._name = mi, name
        self.registry = int(registry_numbers(mi, mi.ShapePtr(shape))[0])
        positions = f"{name}.vertex_positions"
        self._original = {positions: type(parameters[positions])(parameters[positions])}
        start = np.array(parameters[positions], np.float64).reshape(-1, 3)
        final = start @ end[:3, :3].T + end[:3, 3] if end.shape == (4, 4) else end
        if final.shape != start.shape:
            raise _bad(name, f"the mesh has {len(start)} vertices, got positions of shape {final.shape}")
        self._start, self._end = start, final
        self._faces = np.array(parameters[f"{name}.faces"], np.int64).reshape(-1, 3)
        self._transform = end if end.shape == (4, 4) else None
        self._normals: tuple[Float64, Float64] | None = None
        if shape.has_vertex_normals():
            key = f"{name}.vertex_normals"
            self._original[key] = type(parameters[key])(parameters[key])
            normals = np.array(parameters[key], np.float64).reshape(-1, 3)
            self._normals = normals, normals if self._transform is not None else self._computed_normals(final)

    def _computed_normals(self, positions: Float64) -> Float64:
        # On a copy: the scene's acceleration structure refers to the buffers of the mesh itself.
        copy = self._mi.Mesh("copy", len(positions), len(self._faces), has_vertex_normals=True)
        parameters = self._mi.traverse(copy)
        parameters["vertex_positions"] = self._mi.Float(positions.astype(np.float32).ravel())
        parameters["faces"] = self._mi.UInt32(self._faces.astype(np.uint32).ravel())
        parameters.update()
        copy.recompute_vertex_normals()
        return np.array(parameters["vertex_normals"], np.float64).reshape(-1, 3)

    def pose(self, parameters: Any, time: float) -> None:
        values = {"vertex_positions": self._start + time * (self._end - self._start)}
        if self._normals is not None:
            values["vertex_normals"] = _unit(self._normals_at(time, *self._normals))
        for field, value in values.items():
            parameters[f"{self._name}.{field}"] = self._mi.Float(value.astype(np.float32).ravel())

    def _normals_at(self, time: float, start: Float64, end: Float64) -> Float64:
        if self._transform is None:
            return start + time * (end - start)
        a, b, c = _between(self._transform, time)[:3, :3]
        cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
        return np.asarray(start @ cofactors.T)

    def restore(self, parameters: Any) -> None:
        for key, value in self._original.items():
            parameters[key] = value

    def end_points(self) -> Float64:
        return self._end

    def displacement(self, hit: Any, ray: Any, found: npt.NDArray[np.intp], time: float) -> Float64:
        del ray, time  # a point of a triangle is fixed by its barycentric coordinates
        corners = self._faces[np.asarray(hit.prim_index)[found]]
        b1, b2 = np.asarray(hit.prim_uv)[:, found].astype(np.float64)  # elsewhere anything, even NaN
        weights = np.stack([1 - b1 - b2, b1, b2], axis=-1)
        return np.asarray(np.einsum("kc,kcd->kd", weights, (self._end - self._start)[corners]))


class _MovingPose(_Mover):
    """A shape or an instance that Mitsuba places by a transform, ``to_world``."""

    def __init__(self, mi: ModuleType, shape: Any, parameters: Any, name: str, end: Float64) -> None:
        self._mi, self._name, self._key = mi, name, f"{name}.to_world"
        self.registry = int(registry_numbers(mi, mi.ShapePtr(shape))[0])
        if end.shape != (4, 4):
            raise _bad(name, f"{shape.class_name()} has no vertices: give a transform (4 x 4)")
        linear = end[:3, :3]
        similar = np.allclose(linear, np.trace(linear) / 3 * np.eye(3), atol=1e-6)
        if shape.class_name() != "Instance" and not similar:
            raise _bad(
                name,
                f"{shape.class_name()} keeps its form only if it is shifted or scaled evenly; "
                "to turn it, make it a mesh or an instance",
            )
        self._end = end
        self._original = type(parameters[self._key])(parameters[self._key])
        self._start_to_world = np.array(self._original.matrix, np.float64).reshape(4, 4)
        box = shape.bbox()
        self._corners = np.array([[float(box.corner(i)[k]) for k in range(3)] for i in range(8)])

    def pose(self, parameters: Any, time: float) -> None:
        parameters[self._key] = type(self._original)(_between(self._end, time) @ self._start_to_world)

    def restore(self, parameters: Any) -> None:
        parameters[self._key] = self._original

    def end_points(self) -> Float64:
        return np.asarray(self._corners @ self._end[:3, :3].T + self._end[:3, 3])

    def shift(self) -> Float64:
        """Return by how much (3,) it is shifted; raise for other motion."""
        if not np.allclose(self._end[:3, :3], np.eye(3), atol=1e-6):
            raise _bad(
                self._name,
                "a light whose shadows are sampled can only be shifted; shift it, or leave lighting out",
            )
        return self._end[:3, 3]

    def displacement(self, hit: Any, ray: Any, found: npt.NDArray[np.intp], time: float) -> Float64:
        origin, direction = (np.asarray(v)[:, found].astype(np.float64) for v in (ray.o, ray.d))
        point = origin + np.asarray(hit.t)[found] * direction
        now = _between(self._end, time)
        first = np.linalg.solve(now[:3, :3], point - now[:3, 3:])
        return np.asarray((self._end[:3, :3] @ first + self._end[:3, 3:] - first).T)


def _between(end: Float64, time: float) -> Float64:
    """Return the affine map from places at time 0 to places at `time`, when all points travel straight."""
    return np.asarray((1 - time) * np.eye(4) + time * end)


def _mover(mi: ModuleType, shapes: Mapping[str, Any], parameters: Any, name: str, end: Any) -> _Mover:
    if name not in shapes:
        known = sorted(shapes)
        listed = ", ".join(known[:_MAX_LISTED]) + (", …" if len(known) > _MAX_LISTED else "")
        raise _bad(
            name,
            f"the scene has no such shape; it has {listed or 'none with an identifier'}. Mitsuba merges "
            "meshes of one material into a nameless one: load the scene with optimize=False",
        )
    target = _end_of(name, end)
    if f"{name}.vertex_positions" in parameters:
        return _MovingMesh(mi, shapes[name], parameters, name, target)
    if f"{name}.to_world" in parameters:
        return _MovingPose(mi, shapes[name], parameters, name, target)
    raise _bad(name, f"{shapes[name].class_name()} has neither vertices nor a transform that can change")


def _end_of(name: str, end: Any) -> Float64:
    """Return a transform (4, 4) or positions (N, 3) as float64."""
    try:
        value = np.array(getattr(end, "matrix", end), np.float64)
    except (TypeError, ValueError) as error:
        raise _bad(name, f"expected a 4 x 4 transform or positions (N, 3): {error}") from error
    if value.shape == (4, 4, 1):  # transforms of the vectorised variants
        value = value[..., 0]
    if value.shape != (4, 4) and (value.ndim != 2 or value.shape[1] != 3):
        raise _bad(name, f"expected a 4 x 4 transform or positions (N, 3), got shape {value.shape}")
    if not np.isfinite(value).all():
        raise _bad(name, "expected finite numbers")
    if value.shape == (4, 4):
        if not np.allclose(value[3], [0, 0, 0, 1]):
            raise _bad(name, f"expected an affine transform, got the last row {value[3].tolist()}")
        if abs(np.linalg.det(value[:3, :3])) < 1e-12:
            raise _bad(name, "the transform flattens the shape: it has no inverse")
    return value


def registry_numbers(mi: ModuleType, pointer: Any) -> UInt32:
    """Return the numbers by which Dr.Jit tells shapes, or BSDFs, apart; 0 for none."""
    import drjit as dr

    return np.asarray(dr.reinterpret_array(mi.UInt32, pointer), np.uint32).reshape(-1)


def _unit(vectors: Float64) -> Float64:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))


def _bad(name: str, problem: str) -> SampleError:
    return SampleError(problem, field=f"motion[{name!r}]")
