"""Dimensions, tolerances and datums of a STEP file (AP242), for the process that reads CAD files.

Dimensions and datums come from the entities of the file: the kernel's own objects lose the signs of deviations, and
datums whose feature has several faces. Geometric tolerances come from these objects. What the file states and is not
understood has the kind ``other``. Lengths are in metres, angles in radians.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from scancell.geometry.cad_shapes import ByShape, faces_in, labels

_DIMENSIONS = ("diameter", "radius", "size", "distance", "angle")
_SIZES = {"spherical diameter": "diameter", "spherical radius": "radius", "thickness": "size"}
_TOLERANCES = {
    "circular_runout": "run_out",
    "circularity_or_roundness": "roundness",
    "coaxiality": "concentricity",
    "profile_of_line": "line_profile",
    "profile_of_surface": "surface_profile",
    "total_runout": "total_run_out",
    "none": "other",
}
_ZONES = {"none": "width", "diameter": "diameter", "spherical_diameter": "spherical_diameter"}
_MATERIAL = {"m": ["maximum_material_requirement"], "l": ["least_material_requirement"]}

# Statements of the text of a file.
_STRING = r"\s*(?:'(?:[^']|'')*'|\$)\s*"
_FACE = re.compile(r"#(\d+)\s*=\s*ADVANCED_FACE\s*\(")
_DATUM = re.compile(rf"#(\d+)\s*=\s*DATUM\s*\({_STRING},[^;']*(?:'(?:[^']|'')*'[^;']*)?,\s*'((?:[^']|'')*)'\s*\)\s*;")
_RELATED = re.compile(rf"=\s*SHAPE_ASPECT_RELATIONSHIP\s*\({_STRING},{_STRING},\s*#(\d+)\s*,\s*#(\d+)\s*\)")
_SET = re.compile(
    rf"=\s*ITEM_IDENTIFIED_REPRESENTATION_USAGE\s*\({_STRING},{_STRING},\s*#(\d+)\s*,\s*#\d+\s*,"
    r"\s*SET_REPRESENTATION_ITEM\s*\(\s*\(([#\d,\s]*)\)"
)

Described = dict[str, Any]


class Annotations:
    """Dimensions, tolerances and datums of a STEP file that was transferred to a document.

    Parameters
    ----------
    path
        The file.
    reader
        The kernel's reader that read it, with its entities.
    document
        The document into which it transferred the file.
    """

    def __init__(self, path: Path, reader: Any, document: Any) -> None:
        from OCP.StepAP242 import StepAP242_DraughtingModelItemAssociation as Drawn  # noqa: PLC0415
        from OCP.StepAP242 import StepAP242_ItemIdentifiedRepresentationUsage as Usage  # noqa: PLC0415
        from OCP.StepData import StepData_UndefinedEntity as Undefined  # noqa: PLC0415
        from OCP.StepDimTol import StepDimTol_Datum as Datum  # noqa: PLC0415
        from OCP.StepDimTol import StepDimTol_GeometricTolerance as Tolerance  # noqa: PLC0415
        from OCP.StepRepr import StepRepr_ShapeAspectRelationship as Related  # noqa: PLC0415
        from OCP.StepShape import StepShape_AdvancedFace as Face  # noqa: PLC0415
        from OCP.StepShape import StepShape_DimensionalCharacteristicRepresentation as Stated  # noqa: PLC0415
        from OCP.StepShape import StepShape_DimensionalLocation as Location  # noqa: PLC0415
        from OCP.StepShape import StepShape_DimensionalSize as Size  # noqa: PLC0415
        from OCP.StepShape import StepShape_PlusMinusTolerance as PlusMinus  # noqa: PLC0415
        from OCP.XCAFDoc import XCAFDoc_DocumentTool  # noqa: PLC0415

        main = document.Main()
        self._path, self._process = path, reader.WS().TransferReader().TransientProcess()
        self._shapes, self._tool = XCAFDoc_DocumentTool.ShapeTool_s(main), XCAFDoc_DocumentTool.DimTolTool_s(main)
        kinds = (Usage, Datum, Tolerance, Related, Face, Stated, Location, Size, PlusMinus, Undefined)
        model = reader.StepModel()
        every = (model.Value(i) for i in range(1, model.NbEntities() + 1))
        # While an entity is kept it is one object, by whose identity others refer to it.
        self._kept = kept = [entity for entity in every if isinstance(entity, kinds)]
        self._dimensions = [one for one in kept if isinstance(one, (Size, Location))]
        self._tolerances = [one for one in kept if isinstance(one, Tolerance)]
        self._datums = [one for one in kept if isinstance(one, Datum)]
        self._faces = [one for one in kept if isinstance(one, Face)]
        self._stated = {id(one.Dimension().Value()): one for one in kept if isinstance(one, Stated)}
        self._ranges = {id(one.TolerancedDimension().Value()): one for one in kept if isinstance(one, PlusMinus)}
        self._items: dict[int, list[Any]] = defaultdict(list)
        self._related: dict[int, list[Any]] = defaultdict(list)
        self._relating: dict[int, list[Any]] = defaultdict(list)
        self._drawn: dict[int, tuple[str, Any]] = {}  # name in the drawing, and the entity
        aspects: list[Any] = []
        for one in kept:
            if isinstance(one, Usage) and (aspect := one.Definition().Value()) is not None:
                aspects.append(aspect)
                items = [one.IdentifiedItemValue(i) for i in range(1, one.NbIdentifiedItem() + 1)]
                if isinstance(one, Drawn):
                    name = next((_text(item.Name()) for item in items if item is not None), "")
                    self._drawn.setdefault(id(aspect), (name, aspect))
                else:
                    self._items[id(aspect)] += [item for item in items if item is not None]
            elif isinstance(one, Related) and not isinstance(one, Location):
                pair = one.RelatingShapeAspect(), one.RelatedShapeAspect()
                aspects += pair
                self._related[id(pair[0])].append(pair[1])
                self._relating[id(pair[1])].append(pair[0])
        self._aspects = aspects  # kept, as the entities
        # Tolerances of combinations that the kernel does not know.
        self._unknown = [
            {part.StepType(): part.UndefinedContent() for part in _parts(one)}
            for one in kept
            if isinstance(one, Undefined) and one.IsComplex()
        ]
        self._missing: list[str] = []

    def described(self, numbers: ByShape, is_whole: bool) -> tuple[list[Described], list[str]]:
        """All annotations, and remarks; `numbers` are those of the faces of the part.

        Without `is_whole`, those of other faces alone are left out.
        """
        self._numbers, self._is_whole, self._missing = numbers, is_whole, []
        found = [*self._described_datums(), *self._described_dimensions(), *self._described_tolerances()]
        missing = list(dict.fromkeys(self._missing))
        of_datums = [aspect for one in self._datums for aspect in self._relating[id(one)]]
        known = {"", *(one["name"] for one in found), *(self._drawn_name(aspect) for aspect in of_datums)}
        for name, aspect in self._drawn.values():
            if name not in known:
                known.add(name)
                found += self._placed(_described("other", name), self._shapes_of(aspect))
        if not missing:
            return found, []
        return found, [
            f"dimensions, tolerances or datums refer to faces that are not in the part: {', '.join(missing)}"
        ]

    def _drawn_name(self, entity: Any) -> str:
        return self._drawn.get(id(entity), ("", None))[0]

    def _placed(self, described: Described, *groups: Sequence[Any]) -> Iterator[Described]:
        """An annotation with the faces in groups of shapes, None for a missing one, unless other solids have them."""
        faces = [[face for shape in group if shape is not None for face in faces_in(shape)] for group in groups]
        numbers = [sorted({n for face in group for n in self._numbers.of(face)}) for group in faces]
        if any(faces) and not any(numbers) and not self._is_whole:
            return
        described |= dict(zip(("faces", "second_faces"), numbers, strict=False))
        shapes = [shape for group in groups for shape in group]
        if any(shape is not None and not faces_in(shape) for shape in shapes):
            described["modifiers"].append("of_edges_or_points")
        elif None in shapes or not all(numbers):
            self._missing.append(described["name"] or described["kind"])
        yield described

    def _shapes_of(self, aspect: Any) -> list[Any]:
        """Shapes of an aspect and its components; None for a face or an edge that could not be made."""
        from OCP.STEPConstruct import STEPConstruct  # noqa: PLC0415
        from OCP.StepShape import StepShape_TopologicalRepresentationItem  # noqa: PLC0415

        shapes, seen, pending = [], {id(datum) for datum in self._datums} - {id(aspect)}, [aspect]
        while pending:
            one = pending.pop()
            if id(one) in seen:
                continue
            seen.add(id(one))
            pending += self._related[id(one)]
            for item in self._items[id(one)]:
                shape = STEPConstruct.FindShape_s(self._process, item)
                is_lost = shape.IsNull() and isinstance(item, StepShape_TopologicalRepresentationItem)
                shapes.append(None if is_lost else shape)
        return shapes

    def _described_dimensions(self) -> Iterator[Described]:
        from OCP.StepShape import StepShape_AngularLocation, StepShape_AngularSize, StepShape_DimensionalSize  # noqa: PLC0415

        for one in self._dimensions:
            words = _text(one.Name())
            if isinstance(one, (StepShape_AngularLocation, StepShape_AngularSize)):
                kind = "angle"
            elif words.startswith("linear distance"):
                kind = "distance"
            else:
                kind = _SIZES.get(words, words)
            described = _described(kind if kind in _DIMENSIONS else "other", self._drawn_name(one))
            if words not in (described["kind"], "linear distance"):
                described["modifiers"].append(words.replace(" ", "_"))
            self._state(one, described)
            if isinstance(one, StepShape_DimensionalSize):
                yield from self._placed(described, self._shapes_of(one.AppliesTo()))
            else:
                aspects = one.RelatingShapeAspect(), one.RelatedShapeAspect()
                yield from self._placed(described, *map(self._shapes_of, aspects))

    def _state(self, dimension: Any, described: Described) -> None:
        """Give a dimension its value, deviations and modifiers."""
        from OCP.StepShape import StepShape_LimitsAndFits  # noqa: PLC0415

        modifiers, values = described["modifiers"], {}
        if (stated := self._stated.get(id(dimension))) is not None:
            representation = stated.Representation()
            for item in (representation.ItemsValue(i) for i in range(1, representation.NbItems() + 1)):
                if hasattr(item, "Description"):
                    modifiers.append(_text(item.Description()).replace(" ", "_"))
                elif (value := _si(item)) is not None:
                    values[_text(item.Name()) or "nominal value"] = value
                    modifiers += _qualifiers(item)
        low, high = values.get("lower limit"), values.get("upper limit")
        both = (low + high) / 2 if low is not None and high is not None else high if low is None else low
        value = described["value"] = values.get("nominal value", both)
        if value is not None:
            described["lower"] = None if low is None else low - value
            described["upper"] = None if high is None else high - value
        if (stated := self._ranges.get(id(dimension))) is not None:
            limits = stated.Range().Value()
            if isinstance(limits, StepShape_LimitsAndFits):
                modifiers.append(_text(limits.FormVariance()) + _text(limits.Grade()))
            else:
                described["lower"], described["upper"] = _si(limits.LowerBound()), _si(limits.UpperBound())
                if described["lower"] is None or described["upper"] is None:
                    described["kind"] = "other"
                    modifiers.append("unreadable_deviations")

    def _described_tolerances(self) -> Iterator[Described]:
        from OCP.XCAFDoc import XCAFDoc_DimTolTool, XCAFDoc_GeomTolerance  # noqa: PLC0415

        stated = [(_text(one.Name()), _si(one.Magnitude()), one) for one in self._tolerances]
        for label in labels(self._tool.GetGeomToleranceLabels):
            found = XCAFDoc_GeomTolerance.Set_s(label).GetObject()
            name, value = _text(found.GetSemanticName()), 1e-3 * found.GetValue()
            same = [one for one in stated if one[0] == name and _is_near(one[1], value)]
            described = _described(_TOLERANCES.get(kind := _word(found.GetType()), kind), name, value)
            described["zone"] = _ZONES[_word(found.GetTypeOfValue())]
            described["modifiers"] = [_word(one) for one in found.GetModifiers()]
            described["modifiers"] += _MATERIAL.get(_word(found.GetMaterialRequirementModifier()), [])
            if (zone := _word(found.GetZoneModifier())) != "none":
                described["modifiers"].append(f"{zone}_zone {found.GetValueOfZoneModifier():g}")
            if found.GetMaxValueModifier():
                described["modifiers"].append(f"at_most {1e-3 * found.GetMaxValueModifier():g}")
            if (plane := _word(found.GetAffectedPlaneType())) != "none":
                described["modifiers"].append(f"{plane}_plane")
            if same:
                stated.remove(same[0])
                described["modifiers"] += _exceptions(same[0][2])
                aspect = same[0][2].TolerancedShapeAspect().Value()
                described["name"] = self._drawn_name(same[0][2]) or name or self._drawn_name(aspect)
            described["datums"], of_datums = self._references(label)
            described["modifiers"] += of_datums
            first, second = _label_pair(XCAFDoc_DimTolTool.GetRefShapeLabel_s, label)
            yield from self._placed(described, [self._shapes.GetShape_s(one) for one in (*first, *second)])
        for name, value, one in stated:
            kind = _class(one)
            described = _described("other", name, value)
            described["modifiers"] = [kind, *_exceptions(one)]
            yield from self._placed(described, self._shapes_of(one.TolerancedShapeAspect().Value()))
        for types in self._unknown:
            if (content := types.get("GEOMETRIC_TOLERANCE")) is not None:
                described = _described("other", str(content.ParamValue(1).ToCString()).strip("'"))
                described["modifiers"] = [kind.lower() for kind in types if kind != "GEOMETRIC_TOLERANCE"]
                yield from self._placed(described, self._shapes_of(content.ParamEntity(4)))

    def _references(self, label: Any) -> tuple[list[str], list[str]]:
        """Datums of a tolerance in their order, common ones as ``A-B``, and their modifiers."""
        from OCP.XCAFDoc import XCAFDoc_Datum, XCAFDoc_DimTolTool  # noqa: PLC0415

        letters: dict[int, list[str]] = defaultdict(list)
        modifiers = []
        for one in labels(XCAFDoc_DimTolTool.GetDatumWithObjectOfTolerLabels_s, label):
            datum = XCAFDoc_Datum.Set_s(one).GetObject()
            letter, position = _text(datum.GetName()), datum.GetPosition()
            if letter not in letters[position]:
                letters[position].append(letter)
                modifiers += [f"{letter}:{_word(modifier)}" for modifier in datum.GetModifiers()]
        return ["-".join(letters[position]) for position in sorted(letters)], modifiers

    def _described_datums(self) -> Iterator[Described]:
        of_kernel, in_text = self._shapes_of_datums(), None
        for one in self._datums:
            letter = _text(one.Identification())
            described = _described("datum", letter)
            features = [one, *self._relating[id(one)]]
            targets = [feature for feature in features if hasattr(feature, "TargetId")]
            described["modifiers"] = [f"target {_text(target.TargetId())}" for target in targets]
            shapes = [shape for feature in features for shape in self._shapes_of(feature)]
            if not shapes and not (shapes := of_kernel[letter]):
                in_text = _sets_of_datums(self._path) if in_text is None else in_text
                shapes = self._shapes_of_faces(in_text.get(letter, []))
            yield from self._placed(described, shapes)

    def _shapes_of_datums(self) -> dict[str, list[Any]]:
        """Shapes of each datum by the kernel's objects, which know those of datum targets."""
        from OCP.XCAFDoc import XCAFDoc_Datum, XCAFDoc_DimTolTool  # noqa: PLC0415

        found: dict[str, list[Any]] = defaultdict(list)
        for label in labels(self._tool.GetDatumLabels):
            first, second = _label_pair(XCAFDoc_DimTolTool.GetRefShapeLabel_s, label)
            shapes = [self._shapes.GetShape_s(one) for one in (*first, *second)]
            found[_text(XCAFDoc_Datum.Set_s(label).GetObject().GetName())] += shapes
        return found

    def _shapes_of_faces(self, order: Sequence[int]) -> list[Any]:
        """Shapes of the faces that stand at these places among the faces of the file."""
        from OCP.STEPConstruct import STEPConstruct  # noqa: PLC0415

        shapes = [STEPConstruct.FindShape_s(self._process, self._faces[i]) for i in order if i < len(self._faces)]
        return [None if shape.IsNull() else shape for shape in shapes]


def _sets_of_datums(path: Path) -> dict[str, list[int]]:
    """Places, among the faces of the file, of those of each datum that are stated as sets, which the kernel omits."""
    text = path.read_text("latin-1")
    order = {number: place for place, number in enumerate(_FACE.findall(text))}
    letter = dict(_DATUM.findall(text))
    feature = {relating: letter[related] for relating, related in _RELATED.findall(text) if related in letter}
    found: dict[str, list[int]] = defaultdict(list)
    for definition, items in _SET.findall(text):
        if definition in feature or definition in letter:
            places = [order[item] for item in re.findall(r"\d+", items) if item in order]
            found[feature.get(definition) or letter[definition]] += places
    return found


def _described(kind: str, name: str, value: float | None = None) -> Described:
    lists: Described = {key: [] for key in ("faces", "second_faces", "datums", "modifiers")}
    return {"kind": kind, "name": name, "value": value, "lower": None, "upper": None, "zone": "", **lists}


def _parts(entity: Any) -> Iterator[Any]:
    while entity is not None:
        yield entity
        entity = entity.Next()


def _label_pair(list_into: Any, label: Any) -> tuple[list[Any], list[Any]]:
    from OCP.collections import Sequence_TDF_Label  # noqa: PLC0415

    pair = Sequence_TDF_Label(), Sequence_TDF_Label()
    list_into(label, *pair)
    first, second = ([one.Value(i) for i in range(1, one.Length() + 1)] for one in pair)
    return first, second


def _is_near(a: float | None, b: float) -> bool:
    return a is not None and abs(a - b) <= 1e-9 * abs(b)


def _text(text: Any) -> str:
    return "" if text is None else str(text.ToCString()).strip()


def _word(member: Any) -> str:
    """Member of an enumeration of the kernel in lower case, as ``all_around``."""
    word = member.name.removeprefix("XCAFDimTolObjects_").partition("_")[2]
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", word).lower()


def _class(entity: Any) -> str:
    """Kind of a tolerance in the words of the standard, as ``flatness_tolerance``."""
    name = entity.GetToleranceType().name if hasattr(entity, "GetToleranceType") else type(entity).__name__
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.partition("_")[2].removeprefix("GTT")).lower()


def _exceptions(tolerance: Any) -> list[str]:
    """Modifiers that the kernel's objects leave out: a displaced zone, or a value for a length or an area."""
    stated = [("Displacement", "unequally_disposed"), ("UnitSize", "per_length")]
    found = [(word, _si(getattr(tolerance, name)())) for name, word in stated if hasattr(tolerance, name)]
    return [f"{word} {value:g}" for word, value in found if value is not None]


def _qualifiers(item: Any) -> list[str]:
    """Qualifiers of a value, as ``maximum``."""
    if hasattr(item, "GetQualifiedRepresentationItem"):
        item = item.GetQualifiedRepresentationItem()
    if not hasattr(item, "NbQualifiers") or item.Qualifiers() is None:
        return []
    found = [item.QualifiersValue(i).Value() for i in range(1, item.NbQualifiers() + 1)]
    return [_text(one.Name()) for one in found if hasattr(one, "Name")]


def _si(measure: Any) -> float | None:
    """Value of a measure, m or rad; None of one of another kind."""
    from OCP.STEPConstruct import STEPConstruct_UnitContext  # noqa: PLC0415
    from OCP.StepData import StepData_Factors  # noqa: PLC0415

    for name in ("GetMeasureWithUnit", "Measure"):
        measure = getattr(measure, name)() if hasattr(measure, name) else measure
    if measure is None or not hasattr(measure, "UnitComponent"):
        return None
    unit = measure.UnitComponent()
    unit = unit.Value() if hasattr(unit, "Value") else unit
    factors, value = STEPConstruct_UnitContext(), float(measure.ValueComponent())
    if unit is None or factors.ComputeFactors(unit, StepData_Factors()):
        return None
    if factors.PlaneAngleDone():
        return value * float(factors.PlaneAngleFactor())
    return 1e-3 * value * float(factors.LengthFactor()) if factors.LengthDone() else None
