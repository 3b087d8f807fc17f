"""Child process that reads a CAD file with Open CASCADE.

``python -m scancell.geometry.cad_kernel FILE OUT CHORD_MM FREE_FORM_CHORD_MM [SOLID...]`` writes triangles and the
exact surfaces of the faces, of all solids or of those named, into the file OUT (NumPy archive), and a fault as one line
of JSON on its standard output. It is a process of its own, because a damaged file can crash the kernel.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scancell.geometry.cad_annotations import Annotations
from scancell.geometry.cad_shapes import ByShape, faces_in, labels, name_of, shapes_in

UNREADABLE = 3  # exit status: the kernel cannot read the file

_ANGLE = 0.35  # rad between the normals of neighbouring triangles
_MOST_TRIANGLES = 4_000_000
_MOST_NAMES = 20  # in a message
_SHARE = 1e-5  # of the extent of a shape with free-form faces that triangles may be away: finer ones take minutes
_SUFFIXES = {".step": "STEP", ".stp": "STEP", ".iges": "IGES", ".igs": "IGES", ".brep": "BREP", ".brp": "BREP"}


class UnreadableError(Exception):
    """A fault of the file."""


def main() -> int:
    """Read the file that the command line names."""
    source, target, chord, free_form_chord, *solids = sys.argv[1:]
    try:
        content = _Document(Path(source)).triangles(float(chord), float(free_form_chord), solids)
    except UnreadableError as error:
        print(json.dumps({"fault": str(error)}))
        return UNREADABLE
    with Path(target).open("wb") as stream:
        np.savez(stream, **content)
    return 0


class _Solid(NamedTuple):
    """A solid in its place, or a shape without one, with its number in the file and its name."""

    number: int
    name: str
    shape: Any


class _Document:
    """Solids, or else shells and faces, of a CAD file, with the names and colours of their faces; mm."""

    def __init__(self, path: Path) -> None:
        from OCP.TCollection import TCollection_ExtendedString  # noqa: PLC0415
        from OCP.TDocStd import TDocStd_Document  # noqa: PLC0415
        from OCP.XCAFDoc import XCAFDoc_DocumentTool  # noqa: PLC0415

        self._document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
        kind = _SUFFIXES[path.suffix.lower()]
        self._faces_in_file, self._names = 0, ByShape()
        self._read_annotations: Callable[[], Annotations] | None = None
        if kind == "BREP":
            self._roots = [("", self._brep(path))]
            return
        self._read(path, kind)
        main = self._document.Main()
        self._shapes, self._colours = XCAFDoc_DocumentTool.ShapeTool_s(main), XCAFDoc_DocumentTool.ColorTool_s(main)
        for label in self._simple_shapes():
            for part in labels(self._shapes.GetSubShapes_s, label):
                # Some programs write this word where there is no name.
                if (name := name_of(part)) not in ("", "NONE"):
                    self._names.add(self._shapes.GetShape_s(part), name)
        self._roots = list(self._solids())

    def _brep(self, path: Path) -> Any:
        from OCP.BRep import BRep_Builder  # noqa: PLC0415
        from OCP.BRepTools import BRepTools  # noqa: PLC0415
        from OCP.TopoDS import TopoDS_Shape  # noqa: PLC0415

        shape = TopoDS_Shape()
        if not BRepTools.Read_s(shape, str(path), BRep_Builder()) or shape.IsNull():
            raise UnreadableError("the kernel finds no shape in it")
        return shape

    def _read(self, path: Path, kind: str) -> None:
        from OCP.IFSelect import IFSelect_ReturnStatus  # noqa: PLC0415

        if kind == "STEP":
            from OCP.Interface import Interface_Static  # noqa: PLC0415
            from OCP.STEPCAFControl import STEPCAFControl_Reader  # noqa: PLC0415

            reader = STEPCAFControl_Reader()
            Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1)
            reader.SetGDTMode(True)
        else:
            from OCP.IGESCAFControl import IGESCAFControl_Reader  # noqa: PLC0415

            reader = IGESCAFControl_Reader()
        reader.SetNameMode(True)
        reader.SetColorMode(True)
        if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
            raise UnreadableError(f"the kernel finds no {kind} data in it")
        if kind == "STEP":
            model = reader.ChangeReader().StepModel()
            types = Counter(model.Value(i).DynamicType().Name() for i in range(1, model.NbEntities() + 1))
            self._faces_in_file = types["StepShape_AdvancedFace"] + types["StepShape_FaceSurface"]
        if not reader.Transfer(self._document):
            raise UnreadableError(f"the kernel cannot make shapes of its {kind} data")
        if kind == "STEP":
            self._read_annotations = partial(Annotations, path, reader.ChangeReader(), self._document)

    def _solids(self) -> Iterator[tuple[str, Any]]:
        """Name and shape, in its place, of every part of the assembly."""
        from OCP.TopLoc import TopLoc_Location  # noqa: PLC0415

        def walk(label: Any, place: Any, name: str) -> Iterator[tuple[str, Any]]:
            own = name_of(label) or name
            if self._shapes.IsReference_s(label):
                from OCP.TDF import TDF_Label  # noqa: PLC0415

                referred = TDF_Label()
                self._shapes.GetReferredShape_s(label, referred)
                here = place.Multiplied(self._shapes.GetLocation_s(label))
                yield from walk(referred, here, name_of(referred) or own)
            elif self._shapes.IsAssembly_s(label):
                for part in labels(self._shapes.GetComponents_s, label):
                    yield from walk(part, place, own)
            else:
                shape = self._shapes.GetShape_s(label)
                yield own, shape.Moved(place)

        for label in labels(self._shapes.GetFreeShapes):
            yield from walk(label, TopLoc_Location(), "")

    def _simple_shapes(self) -> list[Any]:
        """Labels of shapes that are no assemblies."""
        return [label for label in labels(self._shapes.GetShapes) if self._shapes.IsSimpleShape_s(label)]

    def _kept(self, chosen: Sequence[str]) -> tuple[list[_Solid], list[str]]:
        """Solids where there are some, else all shapes, or those `chosen`; and remarks on what is left out."""
        from OCP.TopAbs import TopAbs_ShapeEnum as Type  # noqa: PLC0415

        found, left = [], 0
        for name, shape in self._roots:
            inside = shapes_in(shape, Type.TopAbs_SOLID)
            # The one solid of a product has the name of the product, which assemblies show.
            found += [((self._names.of(one) or [name])[0] if len(inside) > 1 else name, one) for one in inside]
            left += len(faces_in(shape)) - sum(len(faces_in(one)) for one in inside)
        solids = [_Solid(number, *one) for number, one in enumerate(found or self._roots)]
        if chosen:
            return _chosen(solids, chosen), []
        return solids, [f"{left} faces that belong to no solid are left out"] if found and left else []

    def triangles(self, chord: float, free_form_chord: float, chosen: Sequence[str]) -> dict[str, Any]:
        """Arrays of the archive: vertices, mm, triangles, the face of each, and faces and remarks as JSON.

        Triangles are at most `chord` (mm) from the faces, those of a shape with free-form faces `free_form_chord`.
        Solids are `chosen` by name or number; without any, all are taken.
        """
        from OCP.BRepMesh import BRepMesh_IncrementalMesh  # noqa: PLC0415

        vertices: list[np.ndarray[Any, Any]] = []
        triangles: list[np.ndarray[Any, Any]] = []
        of_face: list[np.ndarray[Any, Any]] = []
        faces: list[dict[str, Any]] = []
        numbers = ByShape()
        count = total = 0
        solids, remarks = self._kept(chosen)
        for number, name, shape in solids:
            found_faces = faces_in(shape)
            surfaces = [_surface(face) for face in found_faces]
            is_free = any("frame" not in surface for surface in surfaces)
            error = max(free_form_chord, _SHARE * _extent(shape)) if is_free else chord
            BRepMesh_IncrementalMesh(shape, min(error, chord), False, _ANGLE, False)
            for face, surface in zip(found_faces, surfaces, strict=True):
                found = _triangulation(face)
                label = (self._names.of(face) or [""])[0]
                described = {"solid": number, "name": name, "label": label, "colour": self._colour(face), **surface}
                numbers.add(face, len(faces))
                faces.append(described)
                if found is None:
                    described["kind"] = "empty"
                    continue
                points, corners = found
                total += len(corners)
                if total > _MOST_TRIANGLES:
                    raise UnreadableError(f"more than {_MOST_TRIANGLES} triangles at a chord error of {chord} mm")
                vertices.append(points)
                triangles.append(corners + count)
                of_face.append(np.full(len(corners), len(faces) - 1))
                count += len(points)
        if not triangles:
            raise UnreadableError("it holds no faces")
        empty = [str(number) for number, face in enumerate(faces) if face["kind"] == "empty"]
        if empty:
            listed = ", ".join(empty[:_MOST_NAMES]) + (", …" if len(empty) > _MOST_NAMES else "")
            remarks.append(f"{len(empty)} of {len(faces)} faces have no area, or no triangles can be made: {listed}")
        stated: list[dict[str, Any]] = []
        if self._read_annotations is not None:
            try:
                stated, faults = self._read_annotations().described(numbers, not chosen)
            except Exception as error:  # the kernel has exceptions of its own; the shapes are good without annotations
                faults = [f"dimensions, tolerances and datums cannot be read: {type(error).__name__}: {error}"]
            remarks += faults
        remarks += self._lost()
        return {
            "vertices": np.concatenate(vertices),
            "triangles": np.concatenate(triangles),
            "face": np.concatenate(of_face),
            "described": np.frombuffer(json.dumps([faces, stated, remarks]).encode(), np.uint8),
        }

    def _lost(self) -> list[str]:
        """Faces of the file that are in no shape; an assembly may hold one shape several times."""
        if not self._faces_in_file:
            return []
        made = sum(len(faces_in(self._shapes.GetShape_s(label))) for label in self._simple_shapes())
        lost = self._faces_in_file - made
        return [f"{lost} of {self._faces_in_file} faces could not be made"] if lost > 0 else []

    def _colour(self, face: Any) -> list[float] | None:
        if not hasattr(self, "_colours"):
            return None
        from OCP.Quantity import Quantity_Color  # noqa: PLC0415
        from OCP.XCAFDoc import XCAFDoc_ColorType  # noqa: PLC0415

        found = Quantity_Color()
        if self._colours.GetColor(face, XCAFDoc_ColorType.XCAFDoc_ColorSurf, found):
            return [round(part, 6) for part in (found.Red(), found.Green(), found.Blue())]
        return None


def _chosen(solids: Sequence[_Solid], words: Sequence[str]) -> list[_Solid]:
    """Solids of which a word is the name, or else the number."""
    kept: set[int] = set()
    for word in words:
        found = {solid.number for solid in solids if solid.name == word}
        found = found or {solid.number for solid in solids if str(solid.number) == word}
        if not found:
            names = list(dict.fromkeys(solid.name for solid in solids if solid.name))
            near = get_close_matches(word, names, n=3)
            listed = [*near, *(name for name in names if name not in near)][:_MOST_NAMES]
            more = f" and {len(names) - len(listed)} more" if len(names) > len(listed) else ""
            known = f"; their names are {', '.join(map(repr, listed))}{more}" if names else ", which have no names"
            raise UnreadableError(f"no solid {word!r} among its {len(solids)} solids (numbers from 0){known}")
        kept |= found
    return [solid for solid in solids if solid.number in kept]


def _extent(shape: Any) -> float:
    """Largest side of the box around a shape, mm."""
    from OCP.Bnd import Bnd_Box  # noqa: PLC0415
    from OCP.BRepBndLib import BRepBndLib  # noqa: PLC0415

    box = Bnd_Box()
    BRepBndLib.Add_s(shape, box)
    low, high = box.CornerMin(), box.CornerMax()
    return float(max(high.X() - low.X(), high.Y() - low.Y(), high.Z() - low.Z()))


def _triangulation(face: Any) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]] | None:
    """Points (n, 3) in their place, mm, and triangles (m, 3), anticlockwise as seen from outside."""
    from OCP.BRep import BRep_Tool  # noqa: PLC0415
    from OCP.TopAbs import TopAbs_Orientation  # noqa: PLC0415
    from OCP.TopLoc import TopLoc_Location  # noqa: PLC0415

    place = TopLoc_Location()
    mesh = BRep_Tool.Triangulation_s(face, place)
    if mesh is None or mesh.NbTriangles() == 0:
        return None
    move = place.Transformation()
    points = np.array(
        [(p.X(), p.Y(), p.Z()) for p in (mesh.Node(i).Transformed(move) for i in range(1, mesh.NbNodes() + 1))]
    )
    corners = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)], np.int64) - 1
    if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
        corners = corners[:, ::-1]
    return points, np.ascontiguousarray(corners)


def _surface(face: Any) -> dict[str, Any]:
    """Kind, frame (4, 4) and dimensions (mm, rad) of the surface on which a face lies."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface  # noqa: PLC0415
    from OCP.GeomAbs import GeomAbs_SurfaceType as Kind  # noqa: PLC0415

    surface = BRepAdaptor_Surface(face)
    kind = surface.GetType()
    if kind == Kind.GeomAbs_Plane:
        return {"kind": "plane", **_frame(surface.Plane().Position())}
    if kind == Kind.GeomAbs_Cylinder:
        one = surface.Cylinder()
        return {"kind": "cylinder", "radius": one.Radius(), **_frame(one.Position())}
    if kind == Kind.GeomAbs_Cone:
        one = surface.Cone()
        return {"kind": "cone", "radius": one.RefRadius(), "second": one.SemiAngle(), **_frame(one.Position())}
    if kind == Kind.GeomAbs_Sphere:
        one = surface.Sphere()
        return {"kind": "sphere", "radius": one.Radius(), **_frame(one.Position())}
    if kind == Kind.GeomAbs_Torus:
        one = surface.Torus()
        return {"kind": "torus", "radius": one.MajorRadius(), "second": one.MinorRadius(), **_frame(one.Position())}
    return {"kind": kind.name.removeprefix("GeomAbs_").removesuffix("Surface").lower()}


def _frame(axes: Any) -> dict[str, Any]:
    """Pose (4, 4), mm, of a coordinate system of the kernel; a left-handed one has its y axis turned round."""
    x, z, origin = axes.XDirection(), axes.Direction(), axes.Location()
    x_axis, z_axis = np.array([x.X(), x.Y(), x.Z()]), np.array([z.X(), z.Y(), z.Z()])
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    matrix[:3, 3] = origin.X(), origin.Y(), origin.Z()
    if not np.isfinite(matrix).all() or not math.isclose(abs(float(np.linalg.det(matrix[:3, :3]))), 1.0, abs_tol=1e-6):
        raise UnreadableError("the coordinate system of a surface is not rigid")
    return {"frame": matrix.tolist()}


if __name__ == "__main__":
    sys.exit(main())
