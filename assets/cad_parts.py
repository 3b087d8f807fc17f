"""Make the sample parts with exact faces, names of faces and tolerances: STEP files (AP242) beside the meshes.

Run it without arguments, or with a folder. Needs Open CASCADE (``pip install "scancell[cad]"``); the files themselves
are in the repository. Lengths are in millimetres; parts stand on z = 0, and datums are faces
that a scan from above sees. Each part takes one deviation of its form,
which is 0 in the files; `tests/bench/cad_variants.py` writes parts with deviations.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from OCP import XCAFDimTolObjects
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeFace,
    BRepBuilderAPI_MakePolygon,
    BRepBuilderAPI_MakeVertex,
    BRepBuilderAPI_MakeWire,
    BRepBuilderAPI_Transform,
)
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.BRepPrimAPI import (
    BRepPrimAPI_MakeBox,
    BRepPrimAPI_MakeCone,
    BRepPrimAPI_MakeCylinder,
    BRepPrimAPI_MakeHalfSpace,
    BRepPrimAPI_MakePrism,
    BRepPrimAPI_MakeTorus,
)
from OCP.collections import Array2_gp_Pnt, HArray1_gp_Pnt, Sequence_TDF_Label
from OCP.GeomAPI import GeomAPI_Interpolate, GeomAPI_PointsToBSplineSurface
from OCP.gp import gp_Ax1, gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.Interface import Interface_Static
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.TCollection import TCollection_ExtendedString, TCollection_HAsciiString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS
from OCP.XCAFDoc import XCAFDoc_Datum, XCAFDoc_Dimension, XCAFDoc_DocumentTool, XCAFDoc_GeomTolerance

NEAR_MM = 0.1  # between a face and the point by which it is named

Point = tuple[float, float, float]


@dataclass
class Part:
    """A solid, names of its faces, each with a point near it, and what its drawing states."""

    name: str
    solid: Any
    faces: dict[str, Point]
    datums: dict[str, str] = field(default_factory=dict)
    diameters: list[tuple[str, float, float, float]] = field(default_factory=list)  # face, value, lower, upper
    distances: list[tuple[str, str, float, float, float]] = field(default_factory=list)
    tolerances: list[tuple[str, str, float, str]] = field(default_factory=list)  # kind, face, value, datums


def block(shift: float = 0.0) -> Part:
    """Block with four bores and a counterbore; `shift` moves ``bore_b`` along x."""
    solid = _box((-45, -30, 0), (45, 30, 28))
    solid = _cut(solid, _cylinder((-30, -15, -1), 6, 40), _cylinder((25 + shift, 12, -1), 8, 40))
    solid = _cut(solid, _cylinder((-22, 14, -1), 5, 40), _cylinder((-22, 14, 18), 9, 40))
    solid = _cut(solid, _cone((28, -14, 14), 4, 9, 14), _box((-5, -31, 20), (9, 5, 40)))
    faces: dict[str, Point] = {"bottom": (0, 0, 0), "top": (40, 0, 28), "left": (-45, 0, 9), "right": (45, 5, 9)}
    faces |= {"front": (-20, -30, 9), "back": (0, 30, 9), "bore_a": (-30, -9, 9), "bore_b": (25, 20, 9)}
    faces |= {"bore_c": (-22, 19, 9), "counterbore": (-22, 23, 24), "counterbore_floor": (-15, 14, 18)}
    faces |= {"countersink": (28, -14 + 6.5, 21), "countersink_floor": (28, -14, 14)}
    faces |= {
        "slot_floor": (2, -10, 20),
        "slot_left": (-5, -10, 24),
        "slot_right": (9, -10, 24),
        "slot_end": (2, 5, 24),
    }
    part = Part("drilled_block", solid, faces, {"A": "top", "B": "left", "C": "front"})
    part.diameters = [("bore_a", 12, -0.05, 0.05), ("bore_b", 16, 0.0, 0.1), ("bore_c", 10, -0.03, 0.03)]
    part.distances = [("top", "slot_floor", 8, -0.1, 0.1)]
    part.tolerances = [("Position", "bore_a", 0.1, "ABC"), ("Position", "bore_b", 0.1, "ABC")]
    part.tolerances += [("Flatness", "top", 0.05, ""), ("Parallelism", "slot_floor", 0.08, "A")]
    part.tolerances += [("Perpendicularity", "left", 0.08, "A"), ("ProfileOfSurface", "countersink", 0.2, "ABC")]
    return part


def turned(shift: float = 0.0) -> Part:
    """Turned part with journals, a cone, a groove and a flat; `shift` moves the axis of ``journal_b`` along x."""
    solid = _fuse(_cylinder((0, 0, 0), 30, 12), _cylinder((0, 0, 11), 20, 29), _cone((0, 0, 40), 20, 12.3, 22))
    solid = _fuse(solid, _cylinder((shift, 0, 59), 13, 26))
    groove = BRepPrimAPI_MakeTorus(gp_Ax2(gp_Pnt(0, 0, 26), gp_Dir(0, 0, 1)), 21, 4).Shape()
    solid = _cut(solid, groove, _box((25, -40, -1), (40, 40, 13)), _cylinder((0, 18, 74), 3, 30))
    solid = _cut(solid, _cylinder((3, 0, 75), 5, 30))
    faces: dict[str, Point] = {"flange_face": (0, 25, 0), "flange_top": (0, 25, 12), "flange": (0, 30, 6)}
    faces |= {"flat": (25, 0, 6), "journal_a_low": (0, 20, 16), "journal_a_high": (0, 20, 36), "groove": (0, 17, 26)}
    faces |= {"cone": (0, -16.5, 50), "journal_b": (-13, 0, 66), "end": (0, -10, 85)}
    faces |= {"hole": (-2, 0, 80), "hole_floor": (3, 0, 75)}
    part = Part("turned_part", solid, faces, {"A": "journal_a_high"})
    part.diameters = [("journal_a_high", 40, -0.04, 0.0), ("journal_b", 26, -0.04, 0.0), ("flange", 60, -0.1, 0.1)]
    part.tolerances = [("CircularRunout", "journal_b", 0.08, "A"), ("TotalRunout", "journal_b", 0.1, "A")]
    part.tolerances += [("Cylindricity", "journal_a_high", 0.04, ""), ("Concentricity", "journal_b", 0.08, "A")]
    part.tolerances += [("ProfileOfSurface", "cone", 0.1, ""), ("Perpendicularity", "flange_top", 0.05, "A")]
    return part


def bracket(tilt: float = 0.0) -> Part:
    """Bracket of a foot and a wall with a slanted side; `tilt` (degrees) turns the face ``wall`` about y."""
    lean = math.tan(math.radians(tilt))
    outline = [(-40.0, 9.0), (-28.0 - lean, 9.0), (-28.0 + 50 * lean, 60.0), (-40.0, 60.0)]
    corner = _turned(_box((-60, -100, 38), (0, 60, 150)), (-34, 25, 38), (1, 0, 0), -30)
    solid = _cut(_fuse(_box((-40, -25, 0), (40, 25, 10)), _prism(outline, -25, 50)), corner)
    solid = _cut(solid, _cylinder((22, -12, -1), 5, 20), _cylinder((8, 12, -1), 3.5, 20))
    solid = _cut(solid, _cylinder((-50, -8, 38), 8, 40, (1, 0, 0)))
    faces: dict[str, Point] = {"bottom": (0, 0, 0), "foot": (30, 5, 10), "end": (40, 0, 5), "front": (0, -25, 5)}
    faces |= {"back": (0, 25, 5), "rear": (-40, 0, 5), "wall": (-28, 10, 20), "top": (-34, -20, 60)}
    faces |= {"slant": (-34, 25 - 20 * _cos(30), 48), "bore_foot_a": (27, -12, 5), "bore_foot_b": (11.5, 12, 5)}
    faces |= {"bore_wall": (-34, 0, 38)}
    part = Part("bracket", solid, faces, {"A": "foot", "B": "rear", "C": "front"})
    part.diameters = [("bore_foot_a", 10, -0.05, 0.05), ("bore_wall", 16, -0.05, 0.05)]
    part.distances = [("front", "back", 50, -0.05, 0.05)]
    part.tolerances = [("Perpendicularity", "wall", 0.05, "A"), ("Flatness", "foot", 0.05, "")]
    part.tolerances += [("Angularity", "slant", 0.1, "A"), ("Position", "bore_wall", 0.15, "ABC")]
    return part


def cover(swelling: float = 0.0) -> Part:
    """Cover whose top is one free-form surface; `swelling` raises it by a smooth bump of that height."""
    xs, ys = ([low + (high - low) * i / 14 for i in range(15)] for low, high in ((-50.0, 50.0), (-40.0, 40.0)))
    grid = Array2_gp_Pnt(1, len(xs), 1, len(ys))
    for i, x in enumerate(xs, 1):
        for j, y in enumerate(ys, 1):
            bump = swelling * math.exp(-((x - 12) ** 2 + (y + 6) ** 2) / 200)
            height = 24 + 5 * math.sin(x / 21 + 0.4) * math.cos(y / 26) + 0.06 * x - 0.002 * y * y + bump
            grid.SetValue(i, j, gp_Pnt(x, y, height))
    surface = GeomAPI_PointsToBSplineSurface(grid, 3, 5).Surface()
    under = BRepPrimAPI_MakeHalfSpace(BRepBuilderAPI_MakeFace(surface, 1e-6).Face(), gp_Pnt(0, 0, -100)).Solid()
    solid = BRepAlgoAPI_Common(_box((-42, -32, 0), (42, 32, 60)), under).Shape()
    solid = _cut(solid, _cylinder((-20, 10, -1), 6, 60))
    top = _height(surface, 5.0, 5.0)
    faces: dict[str, Point] = {"bottom": (0, 0, 0), "left": (-42, 0, 5), "right": (42, 0, 5), "front": (0, -32, 5)}
    faces |= {"back": (0, 32, 5), "bore": (-14, 10, 8), "skin": (5, 5, top)}
    part = Part("free_form_cover", solid, faces, {"A": "bore", "B": "left"})
    part.diameters = [("bore", 12, -0.05, 0.05)]
    part.tolerances = [("ProfileOfSurface", "skin", 0.1, "AB"), ("ProfileOfSurface", "skin", 0.06, "")]
    return part


def ring(lobe: float = 0.0) -> Part:
    """Ring with three unequal lugs; `lobe` is the height, from valley to peak, of three lobes of the ``bore``."""
    lugs = (("a", 20, 9), ("b", 135, 12), ("c", 260, 7))
    solid = _fuse(_cylinder((0, 0, 0), 34, 18), *(_lug(angle, width) for _, angle, width in lugs))
    solid = _cut(solid, _cylinder((0, 0, -1), 25, 40) if lobe == 0 else _lobed_cylinder(25, lobe, -1, 40))
    solid = _cut(solid, *(_cylinder((44 * _cos(a), 44 * _sin(a), -1), 3, 40) for _, a, _ in lugs))
    faces: dict[str, Point] = {"bottom": (0, 29, 0), "top": (0, 29, 18), "bore": (0, 25, 9)}
    faces["outer"] = (34 * _cos(80), 34 * _sin(80), 9)
    for name, angle, width in lugs:
        along, across = (_cos(angle), _sin(angle)), (-_sin(angle), _cos(angle))
        for side, sign in (("left", 1), ("right", -1)):
            at = [42 * along[i] + sign * width * across[i] for i in (0, 1)]
            faces[f"lug_{name}_{side}"] = (at[0], at[1], 5)
        faces[f"lug_{name}_end"] = ((44 + width) * along[0], (44 + width) * along[1], 5)
        faces[f"lug_{name}_top"] = (49 * along[0], 49 * along[1], 10)
        faces[f"hole_{name}"] = (41 * along[0], 41 * along[1], 5)
    part = Part("lobed_ring", solid, faces, {"A": "top", "B": "bore"})
    part.diameters = [("bore", 50, -0.03, 0.03), ("hole_a", 6, -0.1, 0.1)]
    part.distances = [("lug_a_top", "top", 8, -0.05, 0.05)]
    part.tolerances = [("CircularityOrRoundness", "bore", 0.02, ""), ("Cylindricity", "bore", 0.03, "")]
    part.tolerances += [("Perpendicularity", "bore", 0.05, "A"), ("Position", "hole_a", 0.2, "AB")]
    return part


PARTS: dict[str, Callable[[float], Part]] = {
    "drilled_block": block,
    "turned_part": turned,
    "bracket": bracket,
    "free_form_cover": cover,
    "lobed_ring": ring,
}


def write_step(part: Part, file: Path) -> None:
    """Write a part with the names of its faces and its tolerances.

    Raises `ValueError` if a name fits no face or one that has a name already, or a face has none.
    """
    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    shapes, tool = (of(document.Main()) for of in (XCAFDoc_DocumentTool.ShapeTool_s, XCAFDoc_DocumentTool.DimTolTool_s))
    own = shapes.AddShape(part.solid, False)
    TDataStd_Name.Set_s(own, TCollection_ExtendedString(part.name))
    labels = {}
    left = _faces(part.solid)
    for name, point in part.faces.items():
        vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*point)).Vertex()
        near = [face for face in left if BRepExtrema_DistShapeShape(vertex, face).Value() < NEAR_MM]
        if len(near) != 1:
            raise ValueError(f"{part.name}: {len(near)} faces without a name near {point}, expected that of '{name}'")
        left.remove(near[0])
        labels[name] = shapes.AddSubShape(own, near[0])
        TDataStd_Name.Set_s(labels[name], TCollection_ExtendedString(name))
    if left:
        raise ValueError(f"{part.name}: {len(left)} faces have no name")

    def sequence(*names: str) -> Any:
        made = Sequence_TDF_Label()
        for name in names:
            made.Append(labels[name])
        return made

    def dimension(kind: str, value: float, lower: float, upper: float, first: str, *second: str) -> None:
        label, made = tool.AddDimension(), XCAFDimTolObjects.XCAFDimTolObjects_DimensionObject()
        made.SetType(_member("DimensionType", kind))
        made.SetValue(value)
        # The kernel takes the magnitude of the lower deviation and writes its negative.
        made.SetUpperTolValue(upper)
        made.SetLowerTolValue(-lower)
        XCAFDoc_Dimension.Set_s(label).SetObject(made)
        tool.SetDimension(sequence(first), sequence(*second), label)

    for face, *values in part.diameters:
        dimension("Size_Diameter", *values, face)
    for first, second, *values in part.distances:
        dimension("Location_LinearDistance", *values, first, second)
    for kind, face, value, datums in part.tolerances:
        label, made = tool.AddGeomTolerance(), XCAFDimTolObjects.XCAFDimTolObjects_GeomToleranceObject()
        made.SetType(_member("GeomToleranceType", kind))
        made.SetValue(value)
        if kind in ("Position", "Concentricity") or (kind, face) == ("Perpendicularity", "bore"):
            made.SetTypeOfValue(_member("GeomToleranceTypeValue", "Diameter"))
        XCAFDoc_GeomTolerance.Set_s(label).SetObject(made)
        tool.SetGeomTolerance(sequence(face), label)
        for position, letter in enumerate(datums, 1):
            of_datum, datum = tool.AddDatum(), XCAFDimTolObjects.XCAFDimTolObjects_DatumObject()
            datum.SetName(TCollection_HAsciiString(letter))
            datum.SetPosition(position)
            XCAFDoc_Datum.Set_s(of_datum).SetObject(datum)
            tool.SetDatum(sequence(part.datums[letter]), of_datum)
            tool.SetDatumToGeomTol(of_datum, label)
    writer = STEPCAFControl_Writer()
    writer.SetDimTolMode(True)
    Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1)
    Interface_Static.SetCVal_s("write.step.schema", "AP242DIS")
    writer.Transfer(document)
    writer.Write(str(file))
    # Without the time and the path of its writing, the same part gives the same bytes.
    header = f"FILE_NAME('{part.name}','2000-01-01T00:00:00'"
    file.write_text(re.sub(r"FILE_NAME\('[^']*','[^']*'", header, file.read_text(), count=1))


def _member(kind: str, name: str) -> Any:
    prefix = f"XCAFDimTolObjects_{kind}"
    return getattr(getattr(XCAFDimTolObjects, prefix), f"{prefix}_{name}")


def _cos(degrees: float) -> float:
    return math.cos(math.radians(degrees))


def _sin(degrees: float) -> float:
    return math.sin(math.radians(degrees))


def _axes(at: Point, along: Point = (0, 0, 1)) -> gp_Ax2:
    return gp_Ax2(gp_Pnt(*at), gp_Dir(*along))


def _box(low: Point, high: Point) -> Any:
    return BRepPrimAPI_MakeBox(gp_Pnt(*low), gp_Pnt(*high)).Shape()


def _cylinder(at: Point, radius: float, height: float, along: Point = (0, 0, 1)) -> Any:
    return BRepPrimAPI_MakeCylinder(_axes(at, along), radius, height).Shape()


def _cone(at: Point, bottom: float, top: float, height: float) -> Any:
    return BRepPrimAPI_MakeCone(_axes(at), bottom, top, height).Shape()


def _cut(solid: Any, *others: Any) -> Any:
    for other in others:
        solid = BRepAlgoAPI_Cut(solid, other).Shape()
    return solid


def _fuse(solid: Any, *others: Any) -> Any:
    for other in others:
        fused = BRepAlgoAPI_Fuse(solid, other)
        fused.SimplifyResult()
        solid = fused.Shape()
    return solid


def _turned(solid: Any, at: Point, about: Point, degrees: float) -> Any:
    move = gp_Trsf()
    move.SetRotation(gp_Ax1(gp_Pnt(*at), gp_Dir(*about)), math.radians(degrees))
    return BRepBuilderAPI_Transform(solid, move).Shape()


def _prism(outline: Iterable[tuple[float, float]], low: float, length: float) -> Any:
    """Outline in x and z drawn along y."""
    wire = BRepBuilderAPI_MakePolygon()
    for x, z in outline:
        wire.Add(gp_Pnt(x, low, z))
    wire.Close()
    return BRepPrimAPI_MakePrism(BRepBuilderAPI_MakeFace(wire.Wire()).Face(), gp_Vec(0, length, 0)).Shape()


def _lug(angle: float, width: float) -> Any:
    """Lug of half a width with a round end, 10 mm high, along an angle."""
    arm = _fuse(_box((28, -width, 0), (44, width, 10)), _cylinder((44, 0, 0), width, 10))
    return _turned(arm, (0, 0, 0), (0, 0, 1), angle)


def _lobed_cylinder(radius: float, lobe: float, low: float, height: float) -> Any:
    """Prism of a closed smooth curve around a circle, with three lobes."""
    count = 72
    points = HArray1_gp_Pnt(1, count)
    for i in range(count):
        angle = 2 * math.pi * i / count
        r = radius + lobe / 2 * math.cos(3 * angle)
        points.SetValue(i + 1, gp_Pnt(r * math.cos(angle), r * math.sin(angle), low))
    curve = GeomAPI_Interpolate(points, True, 1e-9)
    curve.Perform()
    wire = BRepBuilderAPI_MakeWire(BRepBuilderAPI_MakeEdge(curve.Curve()).Edge()).Wire()
    return BRepPrimAPI_MakePrism(BRepBuilderAPI_MakeFace(wire).Face(), gp_Vec(0, 0, height)).Shape()


def _height(surface: Any, x: float, y: float) -> float:
    """Height of a surface over a point."""
    line = BRepBuilderAPI_MakeEdge(gp_Pnt(x, y, -100), gp_Pnt(x, y, 100)).Edge()
    found = BRepExtrema_DistShapeShape(line, BRepBuilderAPI_MakeFace(surface, 1e-6).Face())
    return float(found.PointOnShape1(1).Z())


def _faces(shape: Any) -> list[Any]:
    explorer, found = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE), []
    while explorer.More():
        found.append(TopoDS.Face(explorer.Current()))
        explorer.Next()
    return found


def main(words: Sequence[str]) -> None:
    """Write all parts into a folder."""
    folder = Path(words[0]) if words else Path(__file__).resolve().parent / "parts"
    for name, make in PARTS.items():
        write_step(make(0.0), folder / f"{name}.step")


if __name__ == "__main__":
    main(sys.argv[1:])
