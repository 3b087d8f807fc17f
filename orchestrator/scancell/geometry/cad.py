"""Parts from CAD files (STEP, IGES, BREP): triangles that know the exact surfaces of the faces on which they lie.

Open CASCADE (extra ``cad``) reads the files in a process of its own, see `scancell.geometry.cad_kernel`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array
from scancell.errors import MeshError, MissingExtraError
from scancell.files import require_file, split_solids
from scancell.geometry import orientation, pose
from scancell.geometry.cad_kernel import UNREADABLE
from scancell.geometry.mesh import Mesh
from scancell.geometry.mesh_files import weld
from scancell.values import Value

CAD_CHORD_ERROR = 5e-6
"""m: distance of the triangles from curved faces; exact surfaces take its place in hits of rays and in distances."""
FREE_FORM_CHORD_ERROR = 1e-6
"""m: the same of parts with faces that have no closed form, whose triangles stay."""

_FOOT = 2.0  # of the chord error by which the distance from an exact surface may differ from that of the triangles
_TIME_LIMIT = 600.0  # s that the kernel may take
_COMMAND = [sys.executable, "-m", "scancell.geometry.cad_kernel"]


CurvedFace = tuple[str, Array, float, float]  # kind, part_from_face, radius and second figure of an exact surface


@dataclass(frozen=True, eq=False, repr=False)
class CadFace(Value):
    """A face of a CAD part.

    Attributes
    ----------
    kind
        ``plane``, ``cylinder``, ``cone``, ``sphere`` or ``torus``; other surfaces by the kernel's name, as ``bspline``.
    part_from_face
        Pose (4, 4) of the surface in the frame of the part, m: about its z axis, a plane in z = 0.
    radius
        Radius, m; of a cone that where z = 0, of a torus that of its centre line; 0 for others.
    second
        Half angle of a cone, rad; radius of the tube of a torus, m; 0 for others.
    name
        Name of the solid, or of the shape, of which it is a face.
    colour
        Red, green and blue, 0 to 1; None if the file states none.
    label
        Name of the face in the file; "" if it has none.
    solid
        Number of the solid in the file, from 0.
    """

    kind: str
    part_from_face: Array
    radius: float = 0.0
    second: float = 0.0
    name: str = ""
    colour: tuple[float, ...] | None = None
    label: str = ""
    solid: int = 0

    @property
    def is_curved(self) -> bool:
        """Whether the face lies on a curved surface whose distance has a closed form."""
        return self.kind in ("cylinder", "cone", "sphere", "torus")

    @property
    def is_exact(self) -> bool:
        """Whether the surface has a closed form, curved or flat."""
        return self.is_curved or self.kind == "plane"

    def nearest(self, points: ArrayLike) -> tuple[Array, Array]:
        """Signed distance (n,), m, of points (n, 3) in the part frame from the untrimmed curved surface, and gradient.

        The distance is positive away from the axis, the centre, or the centre line; the gradient (n, 3) has length 1.
        """
        p = pose.transform_points(pose.inverse(self.part_from_face), points)
        across = np.hypot(p[:, 0], p[:, 1])
        radial = np.column_stack([p[:, :2] / np.where(across > 0, across, 1.0)[:, None], np.zeros(len(p))])
        radial[across == 0, 0] = 1.0
        up = np.array([0.0, 0.0, 1.0])
        match self.kind:
            case "cylinder":
                distance, gradient = across - self.radius, radial
            case "cone":
                cosine, sine = np.cos(self.second), np.sin(self.second)
                distance = cosine * (across - self.radius) - sine * p[:, 2]
                gradient = cosine * radial - sine * up
            case "sphere" | "torus":
                from_centre = p if self.kind == "sphere" else p - self.radius * radial
                length = np.linalg.norm(from_centre, axis=1)
                distance = length - (self.radius if self.kind == "sphere" else self.second)
                gradient = from_centre / np.where(length > 0, length, 1.0)[:, None]
                gradient[length == 0] = up
            case _:
                raise ValueError(f"a face of kind {self.kind} has no distance in closed form")
        return distance, gradient @ self.part_from_face[:3, :3].T


@dataclass(frozen=True)
class Annotation:
    """A dimension, a geometric tolerance or a datum that a STEP file (AP242) states.

    Attributes
    ----------
    kind
        ``diameter``, ``radius``, ``size``, ``distance`` or ``angle``; ``position``, ``flatness``, ``straightness``,
        ``roundness``, ``cylindricity``, ``parallelism``, ``perpendicularity``, ``angularity``, ``line_profile``,
        ``surface_profile``, ``run_out``, ``total_run_out``, ``concentricity`` or ``symmetry``; ``datum``; or ``other``:
        what is not understood, and notes.
    name
        Name in the drawing; letter of a datum; else the kind and the label or number of the first face.
    value
        Nominal value of a dimension, or width of the zone of a tolerance, m or rad; None if the file states none.
    lower, upper
        Deviations from the value that a dimension may have, m or rad; None: not limited.
    faces, second_faces
        Numbers of the faces, from 0; the second ones are those to which a distance or an angle leads.
    datums
        Letters of the datums of a tolerance, in their order; ``A-B``: common datum.
    modifiers
        Further statements: ``maximum_material_requirement``, ``B:maximum_material_requirement`` (of a datum),
        ``all_around``, ``theoretical``, ``auxiliary``, ``H7``, ``target 1``, ``per_length 0.1`` (m), ….
    zone
        Shape of the zone of a tolerance: ``width``, ``diameter`` or ``spherical_diameter``.
    """

    kind: str
    name: str
    value: float | None = None
    lower: float | None = None
    upper: float | None = None
    faces: tuple[int, ...] = ()
    second_faces: tuple[int, ...] = ()
    datums: tuple[str, ...] = ()
    modifiers: tuple[str, ...] = ()
    zone: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class CadMesh(Mesh):
    """Triangles of a CAD part, as `load_part` reads it.

    Attributes
    ----------
    cad_faces
        Faces of the part.
    cad_face
        Number of the face, from 0, on which each triangle lies, (m,).
    chord_error
        Distance of the triangles from curved faces, m.
    annotations
        Dimensions, tolerances and datums of the file.
    """

    cad_faces: tuple[CadFace, ...] = field(kw_only=True)
    cad_face: NDArray[np.int64] = field(kw_only=True)
    chord_error: float = field(kw_only=True)
    annotations: tuple[Annotation, ...] = field(default=(), kw_only=True)

    @property
    def is_exact(self) -> bool:
        """Whether every face has a closed form."""
        return all(face.is_exact for face in self.cad_faces)

    def transformed(self, target_from_part: ArrayLike) -> CadMesh:
        """The part in the frame to which `target_from_part`, a pose (4, 4), leads."""
        moved = super().transformed(target_from_part)
        target = np.asarray(target_from_part, float)
        faces = tuple(replace(face, part_from_face=target @ face.part_from_face) for face in self.cad_faces)
        return replace(self, vertices=moved.vertices, cad_faces=faces)

    def refined(self, points: Array, signed: Array, triangle: NDArray[Any]) -> Array:
        """Distances (n,), m, of points (n, 3) from the exact faces; `signed`: those from the nearest triangles (n,).

        Where the nearest point of the exact surface is not on the face, beyond an edge, that of the triangle stays.
        """
        exact, number = signed.copy(), self.cad_face[triangle]
        order = np.argsort(number, kind="stable")
        cuts = np.flatnonzero(np.diff(number[order])) + 1
        for rows in np.split(order, cuts):
            if not len(rows) or not (face := self.cad_faces[number[rows[0]]]).is_curved:
                continue
            distance, gradient = face.nearest(points[rows])
            outward = self.normals[triangle[rows]]
            distance = np.where(np.einsum("ni,ni->n", gradient, outward) < 0, -distance, distance)
            is_foot = np.abs(distance - signed[rows]) <= _FOOT * self.chord_error
            exact[rows] = np.where(is_foot, distance, signed[rows])
        return exact

    def curved_surfaces(self, triangles: NDArray[np.int64]) -> tuple[list[CurvedFace], NDArray[np.int32]]:
        """Curved faces of triangles (k,) as the ray tracer takes them, and the number of that of each, -1: flat."""
        used, number = np.unique(self.cad_face[triangles], return_inverse=True)
        curved = [face for face in used if self.cad_faces[face].is_curved]
        of_used = np.array([curved.index(face) if face in curved else -1 for face in used], np.int32)
        found = [self.cad_faces[face] for face in curved]
        return [(one.kind, one.part_from_face, one.radius, one.second) for one in found], of_used[number]


def load_cad(path: Path) -> CadMesh:
    """Read a STEP, IGES or BREP file, or some of its solids (``FILE#SOLID``); the file states its unit.

    Raises
    ------
    MissingExtraError
        If the extra ``cad`` is not installed.
    MeshError
        With the file and the fault: missing, not CAD data, empty, without faces or such a solid, or one that crashes
        the kernel.
    """
    file, solids = split_solids(path)
    require_file(file, MeshError)
    with tempfile.TemporaryDirectory(prefix="scancell-cad-") as folder:
        content = _kernel(file, Path(folder) / "part.npz", solids)
    described, stated, found = json.loads(bytes(content["described"]))
    triangles, of_triangle = content["triangles"], content["face"]
    first, number = weld(content["vertices"])
    triangles = number[triangles]
    a, b, c = triangles.T
    whole = (a != b) & (b != c) & (c != a)
    triangles, of_triangle = triangles[whole], of_triangle[whole]
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices = 1e-3 * content["vertices"][first[used]]
    triangles = triangles.reshape(-1, 3).astype(np.int64)
    faces, remarks = _faces(described), [f"{path}: {remark}" for remark in found]
    if not orientation.is_closed(triangles):
        remarks.append(f"{path}: the faces do not close a solid: it has no inside")
    mesh = CadMesh(
        vertices,
        triangles,
        str(path),
        tuple(remarks),
        cad_faces=faces,
        cad_face=of_triangle,
        chord_error=CAD_CHORD_ERROR,
        annotations=tuple(_annotation(one, faces) for one in stated),
    )
    return mesh.usable  # type: ignore[return-value]


def find_faces(part: CadMesh, words: Iterable[str | int]) -> list[int]:
    """Numbers of faces, ascending, that words name: a number from 0, a label, or ``SOLID/LABEL``.

    A label names all faces that have it, as the two halves of a bore; that of one face comes before a number.

    Raises
    ------
    MeshError
        Naming the word, and labels that are like it.
    """
    by_word: dict[str, list[int]] = {}
    for number, face in enumerate(part.cad_faces):
        if face.label:
            for name in {face.label, f"{face.name}/{face.label}"}:
                by_word.setdefault(name, []).append(number)
    found: set[int] = set()
    for word in map(str, words):
        if word in by_word:
            found.update(by_word[word])
        elif word.isdecimal() and int(word) < len(part.cad_faces):
            found.add(int(word))
        else:
            near = get_close_matches(word, by_word, n=5)
            hint = f"; near it: {', '.join(near)}" if near else "" if by_word else "; its faces have no labels"
            count = len(part.cad_faces)
            raise MeshError(
                f"no face '{word}'{hint}",
                file=part.source,
                expected=f"a label, SOLID/LABEL or a number from 0 to {count - 1}",
            )
    return sorted(found)


def _annotation(one: Mapping[str, Any], faces: Sequence[CadFace]) -> Annotation:
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in one.items()}
    of_face = [faces[number].label or f"face {number}" for number in values["faces"][:1]]
    return Annotation(**values | {"name": values["name"] or " ".join([values["kind"].replace("_", " "), *of_face])})


def _faces(described: list[dict[str, Any]]) -> tuple[CadFace, ...]:
    def face(one: Mapping[str, Any]) -> CadFace:
        frame = np.array(one.get("frame", np.eye(4)), float)
        frame[:3, 3] *= 1e-3
        radius, second = 1e-3 * one.get("radius", 0.0), one.get("second", 0.0)
        second *= 1e-3 if one["kind"] == "torus" else 1.0
        colour = None if one["colour"] is None else tuple(one["colour"])
        return CadFace(one["kind"], frame, radius, second, one["name"], colour, one["label"], one["solid"])

    return tuple(face(one) for one in described)


def _kernel(path: Path, target: Path, solids: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Arrays that the child process makes of a file."""
    if find_spec("OCP") is None:
        raise MissingExtraError('CAD files need Open CASCADE; install it with: pip install "scancell[cad]"')
    words = [str(path), str(target), str(1e3 * CAD_CHORD_ERROR), str(1e3 * FREE_FORM_CHORD_ERROR), *solids]
    try:
        done = subprocess.run([*_COMMAND, *words], capture_output=True, text=True, timeout=_TIME_LIMIT, check=False)
    except subprocess.TimeoutExpired:
        raise MeshError(f"the CAD kernel did not finish within {_TIME_LIMIT:.0f} s", file=path) from None
    if done.returncode == UNREADABLE:
        raise MeshError(json.loads(done.stdout.splitlines()[-1])["fault"], file=path)
    if done.returncode < 0:
        raise MeshError(f"the CAD kernel crashed on it (signal {-done.returncode})", file=path)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise MeshError(f"the CAD kernel failed on it: {reason}", file=path)
    with np.load(target, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
