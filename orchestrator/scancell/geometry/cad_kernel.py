"""Child process that reads a CAD file with Open CASCADE.

``python -m scancell.geometry.cad_kernel FILE OUT CHORD_MM FREE_FORM_CHORD_MM`` writes triangles and the exact surfaces
of the faces into the file OUT (NumPy archive), and a fault as one line of JSON on its standard output. It is a process
of its own, because a damaged file can crash the kernel.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

UNREADABLE = 3  # exit status: the kernel cannot read the file

_ANGLE = 0.35  # rad between the normals of neighbouring triangles
_MOST_TRIANGLES = 4_000_000
_SHARE = 1e-5  # of the extent of a shape with free-form faces that triangles may be away: finer ones take minutes
_SUFFIXES = {".step": "STEP", ".stp": "STEP", ".iges": "IGES", ".igs": "IGES", ".brep": "BREP", ".brp": "BREP"}


class UnreadableError(Exception):
    """A fault of the file."""


def main() -> int:
    """Read the file that the command line names."""
    source, target, *chords = sys.argv[1:]
    try:
        content = _Document(Path(source)).triangles(*map(float, chords))
    except UnreadableError as error:
        print(json.dumps({"fault": str(error)}))
        return UNREADABLE
    with Path(target).open("wb") as stream:
        np.savez(stream, **content)
    return 0


class _Document:
    """Solids, or else shells and faces, of a CAD file, with the names and colours of their faces; mm."""

    def __init__(self, path: Path) -> None:
        from OCP.TCollection import TCollection_ExtendedString  # noqa: PLC0415
        from OCP.TDocStd import TDocStd_Document  # noqa: PLC0415
        from OCP.XCAFDoc import XCAFDoc_DocumentTool  # noqa: PLC0415

        self._document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
        kind = _SUFFIXES[path.suffix.lower()]
        self._faces_in_file = 0
        if kind == "BREP":
            self._roots = [("", self._brep(path))]
            return
        self._read(path, kind)
        main = self._document.Main()
        self._shapes, self._colours = XCAFDoc_DocumentTool.ShapeTool_s(main), XCAFDoc_DocumentTool.ColorTool_s(main)
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
            from OCP.STEPCAFControl import STEPCAFControl_Reader  # noqa: PLC0415

            reader = STEPCAFControl_Reader()
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

    def _solids(self) -> Iterator[tuple[str, Any]]:
        """Name and shape, in its place, of every part of the assembly."""
        from OCP.collections import Sequence_TDF_Label  # noqa: PLC0415
        from OCP.TopLoc import TopLoc_Location  # noqa: PLC0415

        labels = Sequence_TDF_Label()
        self._shapes.GetFreeShapes(labels)

        def walk(label: Any, place: Any, name: str) -> Iterator[tuple[str, Any]]:
            own = _name(label) or name
            if self._shapes.IsReference_s(label):
                from OCP.TDF import TDF_Label  # noqa: PLC0415

                referred = TDF_Label()
                self._shapes.GetReferredShape_s(label, referred)
                here = place.Multiplied(self._shapes.GetLocation_s(label))
                yield from walk(referred, here, _name(referred) or own)
            elif self._shapes.IsAssembly_s(label):
                parts = Sequence_TDF_Label()
                self._shapes.GetComponents_s(label, parts)
                for part in _items(parts):
                    yield from walk(part, place, own)
            else:
                shape = self._shapes.GetShape_s(label)
                yield own, shape.Moved(place)

        for label in _items(labels):
            yield from walk(label, TopLoc_Location(), "")

    def _kept(self) -> tuple[list[tuple[str, Any]], list[str]]:
        """Solids where there are some, each with a name; else all shapes; and remarks on what is left out."""
        from OCP.TopAbs import TopAbs_ShapeEnum as Type  # noqa: PLC0415

        solids, left = [], 0
        for name, shape in self._roots:
            inside = _shapes(shape, Type.TopAbs_SOLID)
            solids += [(name, solid) for solid in inside]
            left += len(_shapes(shape, Type.TopAbs_FACE)) - sum(len(_shapes(s, Type.TopAbs_FACE)) for s in inside)
        if not solids:
            return self._roots, []
        return solids, [f"{left} faces that belong to no solid are left out"] if left else []

    def triangles(self, chord: float, free_form_chord: float) -> dict[str, Any]:
        """Arrays of the archive: vertices, mm, triangles, the face of each, and faces and remarks as JSON.

        Triangles are at most `chord` (mm) from the faces, those of a shape with free-form faces `free_form_chord`.
        """
        from OCP.BRepMesh import BRepMesh_IncrementalMesh  # noqa: PLC0415

        vertices: list[np.ndarray[Any, Any]] = []
        triangles: list[np.ndarray[Any, Any]] = []
        of_face: list[np.ndarray[Any, Any]] = []
        faces: list[dict[str, Any]] = []
        count = total = 0
        shapes, remarks = self._kept()
        for number, (name, shape) in enumerate(shapes):
            found_faces = _faces(shape)
            surfaces = [_surface(face) for face in found_faces]
            is_free = any("frame" not in surface for surface in surfaces)
            error = max(free_form_chord, _SHARE * _extent(shape)) if is_free else chord
            BRepMesh_IncrementalMesh(shape, min(error, chord), False, _ANGLE, False)
            for face, surface in zip(found_faces, surfaces, strict=True):
                found = _triangulation(face)
                described = {"part": number, "part_name": name, "colour": self._colour(face), **surface}
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
        return {
            "vertices": np.concatenate(vertices),
            "triangles": np.concatenate(triangles),
            "face": np.concatenate(of_face),
            "described": np.frombuffer(json.dumps([faces, remarks + self._lost()]).encode(), np.uint8),
        }

    def _lost(self) -> list[str]:
        """Faces of the file that are in no shape; an assembly may hold one shape several times."""
        if not self._faces_in_file:
            return []
        from OCP.collections import Sequence_TDF_Label  # noqa: PLC0415

        labels = Sequence_TDF_Label()
        self._shapes.GetShapes(labels)
        simple = [label for label in _items(labels) if self._shapes.IsSimpleShape_s(label)]
        made = sum(len(_faces(self._shapes.GetShape_s(label))) for label in simple)
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


def _items(sequence: Any) -> list[Any]:
    return [sequence.Value(i) for i in range(1, sequence.Length() + 1)]


def _name(label: Any) -> str:
    from OCP.TDataStd import TDataStd_Name  # noqa: PLC0415

    # Looking for an attribute that is not there can end the process.
    if not label.IsAttribute(TDataStd_Name.GetID_s()):
        return ""
    found = TDataStd_Name()
    label.FindAttribute(TDataStd_Name.GetID_s(), found)
    return str(found.Get().ToExtString())


def _shapes(shape: Any, kind: Any) -> list[Any]:
    """All shapes of a kind in a shape, in their places."""
    from OCP.TopExp import TopExp_Explorer  # noqa: PLC0415

    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def _faces(shape: Any) -> list[Any]:
    from OCP.TopAbs import TopAbs_ShapeEnum  # noqa: PLC0415
    from OCP.TopoDS import TopoDS  # noqa: PLC0415

    return [TopoDS.Face(face) for face in _shapes(shape, TopAbs_ShapeEnum.TopAbs_FACE)]


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
