"""Parts from CAD files: exact faces in hits of rays and in distances, units, assemblies, and files with faults."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scancell
from scancell import sensor as sensor_rt
from scancell.errors import MeshError, MissingExtraError
from scancell.geometry import cad, pose
from scancell.geometry.cad import CAD_CHORD_ERROR, Annotation, CadMesh, find_faces
from scancell.geometry.shapes import PartSurface

pytest.importorskip("OCP")

_MAKER = """
import sys
from OCP.BRep import BRep_Builder
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepPrimAPI import (BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCone, BRepPrimAPI_MakeCylinder,
                             BRepPrimAPI_MakeSphere, BRepPrimAPI_MakeTorus)
from OCP.BRepTools import BRepTools
from OCP.IGESControl import IGESControl_Writer
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.TCollection import TCollection_HAsciiString
from OCP.XCAFDimTolObjects import *
from OCP.XCAFDoc import XCAFDoc_Datum, XCAFDoc_Dimension, XCAFDoc_DocumentTool, XCAFDoc_GeomTolerance
from OCP.collections import Sequence_TDF_Label
from OCP.Interface import Interface_Static
from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Compound
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec

folder = sys.argv[1]

def axis(x, y, z, along=(0, 0, 1)):
    return gp_Ax2(gp_Pnt(x, y, z), gp_Dir(*along))

def step(shape, name, unit="MM"):
    Interface_Static.SetCVal_s("write.step.unit", unit)
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(f"{folder}/{name}")

step(BRepPrimAPI_MakeCylinder(axis(3, -2, 1, (1, 2, 4)), 5, 30).Shape(), "cylinder.step")
step(BRepPrimAPI_MakeTorus(axis(1, 2, 3, (1, 0, 3)), 25, 6).Shape(), "torus.step")
block = BRepPrimAPI_MakeBox(gp_Pnt(-30, -20, 0), 60, 40, 25).Shape()
block = BRepAlgoAPI_Cut(block, BRepPrimAPI_MakeCylinder(axis(-15, 5, -1), 6, 30).Shape()).Shape()
block = BRepAlgoAPI_Cut(block, BRepPrimAPI_MakeCone(axis(12, -4, 10), 4, 9, 15.0).Shape()).Shape()
block = BRepAlgoAPI_Fuse(block, BRepPrimAPI_MakeSphere(gp_Pnt(18, 10, 25), 7).Shape()).Shape()
step(block, "block.step")
step(block, "inch.step", "INCH")
BRepTools.Write_s(block, f"{folder}/block.brep")
iges = IGESControl_Writer("MM", 1)
iges.AddShape(block)
iges.ComputeModel()
iges.Write(f"{folder}/block.igs")
builder, many, opened = BRep_Builder(), TopoDS_Compound(), TopoDS_Compound()
builder.MakeCompound(many)
for number in range(200):
    move = gp_Trsf()
    move.SetTranslation(gp_Vec(10 * (number % 20), 10 * (number // 20), 0))
    one = BRepPrimAPI_MakeCylinder(2.0 + 0.005 * number, 8.0).Shape()
    builder.Add(many, one.Moved(TopLoc_Location(move)))
step(many, "many.step")
document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
assembly = shapes.NewShape()

def named(label, name):
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))

named(assembly, "plate with pins")
for number in range(200):
    pin = BRepPrimAPI_MakeCylinder(2.0 + 0.005 * number, 8.0).Shape()
    own = shapes.AddShape(pin, False)
    named(own, f"pin {number}")
    faces = TopExp_Explorer(pin, TopAbs_ShapeEnum.TopAbs_FACE)
    for name in ("mantle", "top", ""):
        if name:
            named(shapes.AddSubShape(own, faces.Current()), name)
        faces.Next()
    move = gp_Trsf()
    move.SetTranslation(gp_Vec(10 * (number % 20), 10 * (number // 20), 0))
    named(shapes.AddComponent(assembly, own, TopLoc_Location(move)), f"place {number}")
shapes.UpdateAssemblies()
writer = STEPCAFControl_Writer()
Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1)
writer.Transfer(document)
writer.Write(f"{folder}/assembly.step")

document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
shapes, tool = (get(document.Main()) for get in (XCAFDoc_DocumentTool.ShapeTool_s, XCAFDoc_DocumentTool.DimTolTool_s))
drilled = BRepPrimAPI_MakeBox(gp_Pnt(-30, -20, 0), 60, 40, 25).Shape()
drilled = BRepAlgoAPI_Cut(drilled, BRepPrimAPI_MakeCylinder(axis(-15, 5, -1), 6, 30).Shape()).Shape()
own, faces, sides = shapes.AddShape(drilled, False), TopExp_Explorer(drilled, TopAbs_ShapeEnum.TopAbs_FACE), {}
for name in ("left", "front", "top", "back", "bottom", "right", "bore"):
    sides[name] = shapes.AddSubShape(own, faces.Current())
    named(sides[name], name)
    faces.Next()

def sequence(*names):
    made = Sequence_TDF_Label()
    for name in names:
        made.Append(sides[name])
    return made

def dimension(kind, value, lower, upper, first, *second):
    label, made = tool.AddDimension(), XCAFDimTolObjects_DimensionObject()
    made.SetType(getattr(XCAFDimTolObjects_DimensionType, f"XCAFDimTolObjects_DimensionType_{kind}"))
    made.SetValue(value)
    made.SetUpperTolValue(upper)
    made.SetLowerTolValue(lower)
    XCAFDoc_Dimension.Set_s(label).SetObject(made)
    tool.SetDimension(sequence(first), sequence(*second), label)

def tolerance(kind, value, faces, datums="", is_round=False):
    label, made = tool.AddGeomTolerance(), XCAFDimTolObjects_GeomToleranceObject()
    made.SetType(getattr(XCAFDimTolObjects_GeomToleranceType, f"XCAFDimTolObjects_GeomToleranceType_{kind}"))
    made.SetValue(value)
    if is_round:
        made.SetTypeOfValue(XCAFDimTolObjects_GeomToleranceTypeValue.XCAFDimTolObjects_GeomToleranceTypeValue_Diameter)
        made.SetMaterialRequirementModifier(
            XCAFDimTolObjects_GeomToleranceMatReqModif.XCAFDimTolObjects_GeomToleranceMatReqModif_M)
    XCAFDoc_GeomTolerance.Set_s(label).SetObject(made)
    tool.SetGeomTolerance(sequence(*faces), label)
    for position, letter in enumerate(datums, 1):
        of_datum, datum = tool.AddDatum(), XCAFDimTolObjects_DatumObject()
        datum.SetName(TCollection_HAsciiString(letter))
        datum.SetPosition(position)
        XCAFDoc_Datum.Set_s(of_datum).SetObject(datum)
        tool.SetDatum(sequence({"A": "bottom", "B": "left", "C": "front"}[letter]), of_datum)
        tool.SetDatumToGeomTol(of_datum, label)

dimension("Size_Diameter", 12, 0.02, 0.05, "bore")
dimension("Location_LinearDistance", 25, 0.1, 0.1, "bottom", "top")
tolerance("Flatness", 0.05, ["bottom"])
tolerance("Position", 0.08, ["bore"], "ABC", True)
tolerance("ProfileOfSurface", 0.2, ["right", "back"], "A")
writer = STEPCAFControl_Writer()
writer.SetDimTolMode(True)
Interface_Static.SetCVal_s("write.step.schema", "AP242DIS")
writer.Transfer(document)
writer.Write(f"{folder}/toleranced.step")
step(BRepPrimAPI_MakeBox(60.0, 40.0, 25.0).Shape(), "plain.step")
builder.MakeCompound(opened)
faces, number = TopExp_Explorer(block, TopAbs_ShapeEnum.TopAbs_FACE), 0
while faces.More():
    if number != 2:
        builder.Add(opened, faces.Current())
    faces.Next()
    number += 1
step(opened, "open.step")
"""

Folder = Path


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """CAD files that the kernel writes."""
    made = tmp_path_factory.mktemp("cad")
    subprocess.run([sys.executable, "-c", _MAKER, str(made)], check=True, capture_output=True)
    return made


def _cylinder(points: Any) -> Any:
    axis = np.array([1.0, 2.0, 4.0]) / np.sqrt(21)
    p = points - 1e-3 * np.array([3.0, -2.0, 1.0])
    along = p @ axis
    across = np.linalg.norm(p - along[:, None] * axis, axis=1)
    outside = np.maximum(np.column_stack([across - 5e-3, np.abs(along - 15e-3) - 15e-3]), 0.0)
    inside = np.minimum(np.maximum(across - 5e-3, np.abs(along - 15e-3) - 15e-3), 0.0)
    return np.hypot(*outside.T) + inside


def _torus(points: Any) -> Any:
    axis = np.array([1.0, 0.0, 3.0]) / np.sqrt(10)
    p = points - 1e-3 * np.array([1.0, 2.0, 3.0])
    along = p @ axis
    across = np.linalg.norm(p - along[:, None] * axis, axis=1)
    return np.hypot(across - 25e-3, along) - 6e-3


@pytest.mark.parametrize(("name", "distance"), [("cylinder", _cylinder), ("torus", _torus)])
def test_distances_are_those_of_the_exact_faces(folder: Folder, name: str, distance: Callable[[Any], Any]) -> None:
    part = scancell.load_part(folder / f"{name}.step")
    random = np.random.default_rng(5)
    on_mesh, _ = scancell.geometry.mesh.sample_surface(part, 4000, 1)
    points = on_mesh + random.uniform(-0.2e-3, 0.2e-3, on_mesh.shape)
    found, _ = PartSurface(part).distances(points)
    plain, _ = PartSurface(scancell.Mesh(part.vertices, part.faces)).distances(points)
    expected = distance(points)
    # Points nearest to an edge keep the distance from the triangles, which meet the edge at its chords.
    assert np.quantile(np.abs(found - expected), 0.99) < 1e-11
    assert np.abs(found - expected).max() < 2 * CAD_CHORD_ERROR
    assert np.sqrt(np.mean((plain - expected) ** 2)) > 0.3e-6


@pytest.mark.parametrize(("name", "distance"), [("cylinder", _cylinder), ("torus", _torus)])
def test_rays_hit_the_exact_faces(folder: Folder, name: str, distance: Callable[[Any], Any]) -> None:
    part = scancell.load_part(folder / f"{name}.step")
    assert isinstance(part, CadMesh)
    exact, plain = sensor_rt.Scene(), sensor_rt.Scene()
    plain.add_mesh("part", part.vertices, part.faces, 0.5)
    exact.add_mesh("part", part.vertices, part.faces, 0.5, *part.curved_surfaces(np.arange(len(part.faces))))
    random = np.random.default_rng(7)
    towards, _ = scancell.geometry.mesh.sample_surface(part, 3000, 2)
    origins = towards + 0.1 * _unit(random.normal(size=towards.shape))
    directions = _unit(towards - origins)
    of_exact, of_plain = (_hits(scene, origins, directions) for scene in (exact, plain))
    hit = np.isfinite(of_exact)
    assert hit.mean() > 0.95
    deviation = distance(origins[hit] + of_exact[hit, None] * directions[hit])
    chords = distance(origins[hit] + of_plain[hit, None] * directions[hit])
    # Single precision of the search decides at grazing incidence, where the triangle counts.
    assert np.quantile(np.abs(deviation), 0.98) < 1e-11
    assert np.abs(deviation).max() < 2 * CAD_CHORD_ERROR
    assert np.quantile(np.abs(chords), 0.5) > 0.3e-6


def test_grazing_rays_end_at_edges_of_faces(folder: Folder) -> None:
    part = scancell.load_part(folder / "cylinder.step")
    assert isinstance(part, CadMesh)
    scene = sensor_rt.Scene()
    scene.add_mesh("part", part.vertices, part.faces, 0.5, *part.curved_surfaces(np.arange(len(part.faces))))
    random = np.random.default_rng(11)
    count = 20_000
    axis = np.array([1.0, 2.0, 4.0]) / np.sqrt(21)
    across = _unit(np.cross(axis, random.normal(size=(count, 3))))
    # The rays cross the untrimmed surface above its end, and the triangles, which lie inside, some of them below it.
    above_end = random.uniform(0.0, 1e-3, (count, 1))
    towards = 1e-3 * np.array([3.0, -2.0, 1.0]) + (30e-3 + above_end) * axis + 5e-3 * across
    directions = _unit(-axis - random.uniform(0.003, 0.1, (count, 1)) * across)
    origins = towards - 0.05 * directions
    ways = _hits(scene, origins, directions)
    hit = np.isfinite(ways)
    deviation = _cylinder(origins[hit] + ways[hit, None] * directions[hit])
    assert hit.mean() > 0.9
    assert np.abs(deviation).max() < 4 * CAD_CHORD_ERROR
    assert np.quantile(np.abs(deviation), 0.7) < 1e-11


def _unit(vectors: Any) -> Any:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _hits(scene: sensor_rt.Scene, origins: Any, directions: Any) -> Any:
    return sensor_rt.cast_rays(scene, np.eye(4)[None], origins, directions)[0]


def test_units_and_formats_give_one_part(folder: Folder) -> None:
    parts = [scancell.load_part(folder / name) for name in ("block.step", "inch.step", "block.igs", "block.brep")]
    for part in parts:
        assert part.is_closed
        assert part.orientation == "outward"
        np.testing.assert_allclose(part.bounds, [[-0.03, -0.02, 0.0], [0.03, 0.02, 0.032]], atol=1e-6)
        kinds = sorted(face.kind for face in part.cad_faces)
        assert kinds == ["cone", "cylinder", *["plane"] * 7, "sphere"]
        radii = {face.kind: face.radius for face in part.cad_faces if face.is_curved}
        assert radii["cylinder"] == pytest.approx(6e-3, abs=1e-9)
        assert radii["sphere"] == pytest.approx(7e-3, abs=1e-9)


def test_faces_move_with_the_part(folder: Folder) -> None:
    part = scancell.load_part(folder / "block.step")
    move = pose.from_euler_xyz((0.1, -0.2, 0.3), (0.4, -0.5, 0.6))
    random = np.random.default_rng(3)
    points = scancell.geometry.mesh.sample_surface(part, 2000, 4)[0] + random.uniform(-1e-4, 1e-4, (2000, 3))
    at_home = PartSurface(part).distances(points)[0]
    moved = PartSurface(part.transformed(move)).distances(pose.transform_points(move, points))[0]
    np.testing.assert_allclose(moved, at_home, atol=1e-12)


def test_assembly_keeps_its_solids(folder: Folder) -> None:
    part = scancell.load_part(folder / "many.step")
    assert len(part.cad_faces) == 600
    assert part.is_closed
    radii = sorted(face.radius for face in part.cad_faces if face.kind == "cylinder")
    np.testing.assert_allclose(radii, 1e-3 * (2.0 + 0.005 * np.arange(200)), atol=1e-9)


def test_solids_are_chosen_by_name(folder: Folder) -> None:
    whole = scancell.load_part(folder / "assembly.step")
    assert len({face.solid for face in whole.cad_faces}) == 200
    one = scancell.load_part(folder / "assembly.step#pin 123")
    assert {(face.name, face.solid) for face in one.cad_faces} == {("pin 123", 123)}
    # It stays in its place in the assembly.
    np.testing.assert_allclose(one.bounds[:, :2].mean(0), [0.03, 0.06], atol=1e-6)
    several = scancell.load_part(folder / "assembly.step#pin 7#199")
    assert [face.name for face in several.cad_faces] == ["pin 7"] * 3 + ["pin 199"] * 3
    with pytest.raises(MeshError, match=r"no solid 'pin 1234'.* 200 solids.*'pin 123', .*and 180 more"):
        scancell.load_part(folder / "assembly.step#pin 7#pin 1234")
    with pytest.raises(MeshError, match=r"missing\.step: no such file"):
        scancell.load_part(folder / "missing.step#pin 7")


def test_solid_without_names_is_chosen_by_number(folder: Folder) -> None:
    part = scancell.load_part(folder / "many.step#17")
    assert {face.solid for face in part.cad_faces} == {17}
    assert next(face.radius for face in part.cad_faces if face.is_curved) == pytest.approx(1e-3 * (2.0 + 0.005 * 17))
    with pytest.raises(MeshError, match=r"no solid '200'"):
        scancell.load_part(folder / "many.step#200")


def test_descriptions_name_solids(folder: Folder) -> None:
    setting = (
        f"cell.obstacle=[{{name='pin', moves_with='world', mesh='{folder}/assembly.step#pin 5', pose={{x_mm=900}}}}]"
    )
    setup = scancell.load_setup(settings=[setting])
    assert setup.cell.obstacle[0].mesh == f"{folder}/assembly.step#pin 5"
    nominal = scancell.nominal_cell(setup.cell, None)
    pin = next(body.mesh for body in nominal.bodies if body.name == "pin")
    np.testing.assert_allclose(np.ptp(pin.bounds, axis=0)[2], 8e-3, atol=1e-6)
    with pytest.raises(scancell.DescriptionError, match=r"no such file; tried .*none\.step#pin 5"):
        scancell.load_setup(settings=[setting.replace("assembly", "none")])


def test_faces_are_found_by_words(folder: Folder) -> None:
    part = scancell.load_part(folder / "assembly.step#pin 0#pin 1#pin 2")
    assert isinstance(part, CadMesh)
    assert [face.label for face in part.cad_faces] == ["mantle", "top", ""] * 3
    assert find_faces(part, ["mantle"]) == [0, 3, 6]
    assert find_faces(part, ["pin 2/top", "pin 0/mantle", 2, "2"]) == [0, 2, 7]
    assert find_faces(part, []) == []
    with pytest.raises(MeshError, match=r"assembly\.step.*no face 'pin 2/mantel'; near it: pin 2/mantle"):
        find_faces(part, ["top", "pin 2/mantel"])
    for word in (9, "-1", "", "²"):
        with pytest.raises(MeshError, match=f"no face '{word}'.*0 to 8"):
            find_faces(part, [word])
    with pytest.raises(MeshError, match="have no labels"):
        find_faces(scancell.load_part(folder / "cylinder.step"), ["mantle"])


def _toleranced(folder: Path, tmp_path: Path, *changes: tuple[str, str]) -> CadMesh:
    """The drilled block with tolerances, with changes (pattern, replacement) of the text of its file."""
    text = re.sub(r"\n(?!#|ENDSEC|DATA)", " ", (folder / "toleranced.step").read_text())
    for pattern, by in changes:
        text, count = re.subn(pattern, by, text)
        assert count, pattern
    file = tmp_path / "part.step"
    file.write_text(text)
    part = scancell.load_part(file)
    assert isinstance(part, CadMesh)
    return part


def test_file_of_ap242_without_tolerances(folder: Folder) -> None:
    assert "AP242" in (folder / "plain.step").read_text()
    part = scancell.load_part(folder / "plain.step")
    assert part.annotations == ()
    assert not part.warnings


def test_faces_without_area_are_said(folder: Folder, tmp_path: Path) -> None:
    file = tmp_path / "flat.step"
    file.write_text((folder / "plain.step").read_text().replace("25.)", "0.)"))
    part = scancell.load_part(file)
    assert sum(face.kind == "empty" for face in part.cad_faces) == 4
    assert any("4 of 6 faces have no area" in warning for warning in part.warnings)


@pytest.mark.parametrize(
    ("pattern", "by", "kinds"),
    [
        (r"TOLERANCE_VALUE\(#\d+,", "TOLERANCE_VALUE($,", {"diameter": 0, "distance": 0, "other": 2}),
        (r"DIMENSIONAL_SIZE\(#\d+,", "DIMENSIONAL_SIZE(#99999,", {"diameter": 1}),
        (r"(FLATNESS_TOLERANCE\('',''),#\d+,", r"\1,$,", {"diameter": 1, "distance": 1}),
    ],
)
def test_damaged_tolerances_leave_the_shapes(
    folder: Folder, tmp_path: Path, pattern: str, by: str, kinds: dict[str, int]
) -> None:
    part = _toleranced(folder, tmp_path, (pattern, by))
    assert len(part.cad_faces) == 7
    assert part.is_closed
    found = Counter(one.kind for one in part.annotations)
    assert {kind: found[kind] for kind in kinds} == kinds


def test_fault_in_reading_tolerances_is_said(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = (
        "from scancell.geometry import cad_kernel as k; k.Annotations = lambda *_: 1 / 0; raise SystemExit(k.main())"
    )
    monkeypatch.setattr(cad, "_COMMAND", [sys.executable, "-c", broken])
    part = scancell.load_part(folder / "toleranced.step")
    assert len(part.cad_faces) == 7
    assert any("tolerances and datums cannot be read: ZeroDivisionError" in warning for warning in part.warnings)


def _only(part: CadMesh, kind: str) -> Annotation:
    (found,) = (one for one in part.annotations if one.kind == kind)
    return found


def test_tolerances_and_datums_are_read(folder: Folder) -> None:
    part = scancell.load_part(folder / "toleranced.step")
    assert isinstance(part, CadMesh)
    left, front, top, back, bottom, right, bore = range(7)
    assert [face.label for face in part.cad_faces] == ["left", "front", "top", "back", "bottom", "right", "bore"]
    assert part.annotations == (
        Annotation("datum", "A", faces=(bottom,)),
        Annotation("datum", "B", faces=(left,)),
        Annotation("datum", "C", faces=(front,)),
        Annotation("diameter", "diameter bore", _mm(12), _mm(-0.02), _mm(0.05), (bore,)),
        Annotation("distance", "distance bottom", _mm(25), _mm(-0.1), _mm(0.1), (bottom,), (top,)),
        Annotation("flatness", "flatness bottom", _mm(0.05), faces=(bottom,), zone="width"),
        Annotation(
            "position",
            "position bore",
            _mm(0.08),
            faces=(bore,),
            datums=("A", "B", "C"),
            modifiers=("maximum_material_requirement",),
            zone="diameter",
        ),
        Annotation(
            "surface_profile", "surface profile back", _mm(0.2), faces=(back, right), datums=("A",), zone="width"
        ),
    )
    assert not part.warnings
    assert part.transformed(pose.translation((1.0, 0.0, 0.0))).annotations == part.annotations
    assert scancell.load_part(folder / "block.step").annotations == ()


def _mm(value: float) -> Any:
    return pytest.approx(1e-3 * value, rel=1e-9)


@pytest.mark.parametrize(("lower", "upper"), [(-0.07, -0.02), (0.02, 0.05)])
def test_deviations_keep_their_signs(folder: Folder, tmp_path: Path, lower: float, upper: float) -> None:
    changes = [(r"MEASURE_WITH_UNIT\(5.E-02,", f"MEASURE_WITH_UNIT({upper},")]
    changes += [(r"MEASURE_WITH_UNIT\(-2.E-02,", f"MEASURE_WITH_UNIT({lower},")]
    bore = _only(_toleranced(folder, tmp_path, *changes), "diameter")
    assert (bore.value, bore.lower, bore.upper) == (_mm(12), _mm(lower), _mm(upper))


def test_angles_are_in_radians_and_limits_become_deviations(folder: Folder, tmp_path: Path) -> None:
    unit = r"(#\d+) = \( NAMED_UNIT\(\*\) PLANE_ANGLE_UNIT"
    (radian,) = re.findall(unit, re.sub(r"\s+", " ", (folder / "toleranced.step").read_text()))
    part = _toleranced(
        folder,
        tmp_path,
        (r"DIMENSIONAL_LOCATION\('linear distance',(.*?)\)", r"ANGULAR_LOCATION('angle',\1,.SMALL.)"),
        (
            r"\( LENGTH_MEASURE_WITH_UNIT\(\)([^;]*?)POSITIVE_LENGTH_MEASURE\(25.\),#\d+",
            rf"( PLANE_ANGLE_MEASURE_WITH_UNIT()\1PLANE_ANGLE_MEASURE(1.5),{radian}",
        ),
        (
            r"(#\d+) = MEASURE_WITH_UNIT\((-?)0.1,#\d+",
            rf"\1 = PLANE_ANGLE_MEASURE_WITH_UNIT(PLANE_ANGLE_MEASURE(\g<2>0.002),{radian}",
        ),
    )
    angle = _only(part, "angle")
    assert (angle.value, angle.lower, angle.upper) == pytest.approx((1.5, -0.002, 0.002), rel=1e-9)
    assert (angle.faces, angle.second_faces) == ((4,), (2,))


def test_what_is_not_understood_is_listed(folder: Folder, tmp_path: Path) -> None:
    part = _toleranced(
        folder,
        tmp_path,
        (
            r"FLATNESS_TOLERANCE\('','',(#\d+),(#\d+)\)",
            r"(FLATNESS_TOLERANCE()GEOMETRIC_TOLERANCE('per area','',\1,\2)"
            r"GEOMETRIC_TOLERANCE_WITH_DEFINED_AREA_UNIT(.RECTANGULAR.,\1)GEOMETRIC_TOLERANCE_WITH_DEFINED_UNIT(\1))",
        ),
        (r"DIMENSIONAL_SIZE\((#\d+),'diameter'\)", r"DIMENSIONAL_SIZE(\1,'toroidal minor diameter')"),
    )
    others = {one.name: one for one in part.annotations if one.kind == "other"}
    assert others["per area"].faces == (4,)
    assert "flatness_tolerance" in others["per area"].modifiers
    assert others["other bore"].value == _mm(12)
    assert others["other bore"].modifiers == ("toroidal_minor_diameter",)
    assert len(part.annotations) == 8


def test_datum_of_a_set_of_faces(folder: Folder, tmp_path: Path) -> None:
    feature = r"GEOMETRIC_ITEM_SPECIFIC_USAGE\('','',(#\d+),(#\d+),(#\d+)\);(\s*#\d+ = DATUM\('','',#\d+,.F.,'A'\))"
    (top,) = re.findall(r"(#\d+) = ADVANCED_FACE\('top'", (folder / "toleranced.step").read_text())
    of_set = rf"ITEM_IDENTIFIED_REPRESENTATION_USAGE('',$,\1,\2,SET_REPRESENTATION_ITEM((\3,{top})));\4"
    part = _toleranced(folder, tmp_path, (feature, of_set))
    assert next(one for one in part.annotations if one.name == "A").faces == (2, 4)


def test_tolerances_of_missing_faces_are_said(folder: Folder, tmp_path: Path) -> None:
    part = _toleranced(folder, tmp_path, ("CYLINDRICAL_SURFACE", "CYLINDRICAL_SURFOCE"))
    assert any("1 of 7 faces could not be made" in warning for warning in part.warnings)
    (warning,) = (warning for warning in part.warnings if "not in the part" in warning)
    assert warning.endswith("refer to faces that are not in the part: diameter, other")
    assert _only(part, "diameter").faces == ()


def test_open_shell_is_said(folder: Folder) -> None:
    part = scancell.load_part(folder / "open.step")
    assert not part.is_closed
    assert any("do not close a solid" in warning for warning in part.warnings)
    assert (PartSurface(part).distances(part.vertices[:5] + 1e-4)[0] >= 0).all()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"hello\n", "no STEP data"),
        (bytes(range(256)) * 20, "no STEP data"),
        (b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n", "cannot make shapes"),
    ],
)
def test_file_without_shapes_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    file = tmp_path / "part.step"
    file.write_bytes(content)
    with pytest.raises(MeshError, match=message):
        scancell.load_part(file)


def test_lost_faces_are_said(folder: Folder, tmp_path: Path) -> None:
    file = tmp_path / "part.step"
    text = (folder / "block.step").read_text()
    file.write_text(text.replace("CYLINDRICAL_SURFACE", "CYLINDRICAL_SURFOCE"))
    part = scancell.load_part(file)
    assert any("1 of 10 faces" in warning for warning in part.warnings)
    file.write_text(text[: len(text) // 2])
    with pytest.raises(MeshError, match="no STEP data"):
        scancell.load_part(file)


def test_crash_of_the_kernel_is_a_message(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    crash = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
    monkeypatch.setattr(cad, "_COMMAND", [sys.executable, "-c", crash])
    with pytest.raises(MeshError, match=r"block\.step.*crashed on it \(signal 11\)"):
        scancell.load_part(folder / "block.step")


def test_kernel_that_hangs_is_stopped(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cad, "_COMMAND", [sys.executable, "-c", "import time; time.sleep(60)"])
    monkeypatch.setattr(cad, "_TIME_LIMIT", 0.5)
    with pytest.raises(MeshError, match=r"block\.step.*did not finish within"):
        scancell.load_part(folder / "block.step")


def test_missing_extra_is_named(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cad, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"scancell\[cad\]"):
        scancell.load_part(folder / "block.step")


def test_scan_of_a_cylinder_from_cad_has_no_facets(folder: Folder) -> None:
    settings = ["cell.part.x_mm=9", "cell.part.ry_deg=20", "scan.max_profiles=40"]
    with scancell.Scanner(settings=settings, ideal=True) as scanner:
        result = scanner.scan(folder / "torus.step", engine="geometric").evaluate()
    assert result.deviation.is_exact
    assert np.quantile(np.abs(result.deviation.distance), 0.99) < 1e-10
    assert len(result.cloud) > 5000
