"""Results of an inspection as a document of the Quality Information Framework (QIF 3.0, ISO 23952)."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5
from xml.etree import ElementTree

import numpy as np

import scancell
from scancell.arrays import Array
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh
from scancell.inspection.annotations import surfaces_of
from scancell.inspection.features import Feature, MeasuredPart
from scancell.inspection.inspection import Decision, Inspection, Verdict

QIF_NAMESPACE = "http://qifstandards.org/xsd/qif3"

_TYPES = {
    "diameter": "Diameter",
    "radius": "Radius",
    "distance": "DistanceBetween",
    "angle": "AngleBetween",
    "straightness": "Straightness",
    "flatness": "Flatness",
    "roundness": "Circularity",
    "cylindricity": "Cylindricity",
    "parallelism": "Parallelism",
    "perpendicularity": "Perpendicularity",
    "angularity": "Angularity",
    "position": "Position",
    "coaxiality": "Coaxiality",
    "symmetry": "Symmetry",
    "circular_run_out": "CircularRunout",
    "total_run_out": "TotalRunout",
    "surface_profile": "SurfaceProfile",
}
_STATUS: dict[Verdict, str] = {
    "conforms": "PASS",
    "does not conform": "FAIL",
    "cannot be decided": "INDETERMINATE",
    "not evaluated": "NOT_ANALYZED",
}
_FEATURES = ("plane", "cylinder", "cone", "sphere")  # that QIF describes as scancell does
_PRECEDENCE = ("PRIMARY", "SECONDARY", "TERTIARY")
_LABEL = re.compile(r"[A-Za-z0-9._:-]+")  # of a datum (NMTOKEN)
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_ASPECTS = ("Definitions", "Nominals", "Items")
_STATED = ("interval_low", "interval_high", "by_", "correction", "probability", "points")


def write_qif(inspection: Inspection, path: Path) -> None:
    """Write definitions, nominals, items and measured values of all characteristics of an inspection.

    Lengths are in mm, angles in degrees. ``combinedUncertainty`` is the combined standard uncertainty. The identifier
    of the document follows from its content, which holds no time: the same inspection makes the same bytes.

    Raises `OutputError` if the file cannot be written.
    """
    root = _Document(inspection).root
    ElementTree.indent(root)
    with atomic_write(path) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


class _Document:
    """Elements of the document, and the number of those that have an identifier."""

    def __init__(self, inspection: Inspection) -> None:
        self._inspection, self._count = inspection, 0
        self._nominal_of: dict[tuple[int, ...], int] = {}
        self._item_of: dict[tuple[int, ...], int] = {}
        self.root = ElementTree.Element("QIFDocument", xmlns=QIF_NAMESPACE, versionQIF="3.0.0", idMax="0")
        content = json.dumps(inspection.figures, sort_keys=True)
        _add(self.root, "QPId", str(uuid5(NAMESPACE_URL, f"{scancell.__version__} {content}")))
        application = _add(_add(self.root, "Header"), "Application")
        _add(application, "Name", f"scancell {scancell.__version__}")
        self._standard = self._standards()
        self._units()
        self._frames = self._datums()
        self._part()
        self._features()
        items = self._characteristics()
        self._results(items)
        self.root.set("idMax", str(self._count))

    def _new(self, parent: ElementTree.Element, tag: str) -> ElementTree.Element:
        """Element with an identifier."""
        self._count += 1
        return ElementTree.SubElement(parent, tag, id=str(self._count))

    def _standards(self) -> str:
        """Identifier of the standard of the tolerances."""
        standard = self._new(_add(self.root, "StandardsDefinitions", n="1"), "Standard")
        _add(_add(standard, "Organization"), "StandardsOrganizationEnum", "ISO")
        _add(standard, "Designator", "1101")
        return standard.attrib["id"]

    def _units(self) -> None:
        units = _add(_add(self.root, "FileUnits"), "PrimaryUnits")
        for tag, base, name, factor in (
            ("AngularUnit", "radian", "degree", f"{np.pi / 180:.18f}"),
            ("LinearUnit", "meter", "mm", "0.001"),
        ):
            unit = _add(units, tag)
            _add(unit, "SIUnitName", base)
            _add(unit, "UnitName", name)
            _add(_add(unit, "UnitConversion"), "Factor", factor)

    def _datums(self) -> dict[tuple[str, ...], str]:
        """Identifiers of the datum systems by their datums."""
        inspection = self._inspection
        if not inspection.description.datum:
            return {}
        definitions = _add(self.root, "DatumDefinitions", n=str(len(inspection.description.datum)))
        of_name = {}
        for number, one in enumerate(inspection.description.datum, 1):
            made = self._new(definitions, "DatumDefinition")
            _add(made, "DatumLabel", one.name if _LABEL.fullmatch(one.name) else f"datum-{number}")
            of_name[one.name] = made.attrib["id"]
        systems = dict.fromkeys(one.description.datums for one in inspection.decisions if one.description.datums)
        if not systems:
            return {}
        frames, found = _add(self.root, "DatumReferenceFrames", n=str(len(systems))), {}
        for names in systems:
            frame = self._new(frames, "DatumReferenceFrame")
            datums = _add(frame, "Datums", n=str(len(names)))
            for name, precedence in zip(names, _PRECEDENCE, strict=False):
                datum = _add(datums, "Datum")
                simple = _add(datum, "SimpleDatum")
                _add(simple, "DatumDefinitionId", of_name[name])
                _add(simple, "MaterialModifier", "NONE")
                _add(simple, "ReferencedComponent", "ACTUAL")
                _add(_add(datum, "Precedence"), "PrecedenceEnum", precedence)
            found[names] = frame.attrib["id"]
        return found

    def _part(self) -> None:
        product = _add(self.root, "Product")
        part = self._new(_add(product, "PartSet", n="1"), "Part")
        header = _add(part, "Header")
        _add(header, "Name", Path(self._inspection.part.source).stem)
        _add(_add(header, "File"), "Name", self._inspection.part.source)
        _add(_add(product, "RootPart"), "Id", part.attrib["id"])

    def _features(self) -> None:
        """One feature for each surface of a toleranced feature or datum that QIF describes."""
        part = self._inspection.part
        surfaces: dict[tuple[int, ...], Feature] = {}
        nothing = MeasuredPart(part, np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64))
        for one in self._inspection.decisions:
            for group in _surfaces(self._inspection, one):
                if part.cad_faces[group[0]].kind in _FEATURES and group not in surfaces:
                    surfaces[group] = nothing.feature(_name(part, group), group, 0.0)
        if not surfaces:
            return
        features, count = _add(self.root, "Features"), str(len(surfaces))
        definitions, nominals, items = (_add(features, f"Feature{kind}", n=count) for kind in _ASPECTS)
        for group, feature in surfaces.items():
            tag = f"{feature.kind.capitalize()}Feature"
            definition = self._new(definitions, f"{tag}Definition")
            _define(definition, feature)
            nominal = self._new(nominals, f"{tag}Nominal")
            _add(nominal, "Name", feature.name)
            _add(nominal, "FeatureDefinitionId", definition.attrib["id"])
            _place(nominal, feature)
            item = self._new(items, f"{tag}Item")
            _add(item, "FeatureNominalId", nominal.attrib["id"])
            _add(item, "FeatureName", feature.name)
            _add(_add(item, "DeterminationMode"), "Checked")
            self._nominal_of[group], self._item_of[group] = int(nominal.attrib["id"]), int(item.attrib["id"])

    def _characteristics(self) -> list[str]:
        """Identifiers of the items of all characteristics."""
        decisions = self._inspection.decisions
        listed, count = _add(self.root, "Characteristics"), str(len(decisions))
        _add(listed, "FormalStandardId", self._standard)
        definitions, nominals, items = (_add(listed, f"Characteristic{kind}", n=count) for kind in _ASPECTS)
        found = []
        for one in decisions:
            groups, tag = _surfaces(self._inspection, one), _type(self._inspection, one)
            definition = self._new(definitions, f"{tag}CharacteristicDefinition")
            _add(definition, "Name", one.description.name)
            if one.description.is_size:
                _limit(definition, one)
            else:
                self._zone(definition, one)
            nominal = self._new(nominals, f"{tag}CharacteristicNominal")
            _attributes(nominal, {"faces": one.row()["faces"]})
            _add(nominal, "CharacteristicDefinitionId", definition.attrib["id"])
            _references(nominal, "FeatureNominalIds", [self._nominal_of[g] for g in groups if g in self._nominal_of])
            _add(nominal, "Name", one.description.name)
            if one.description.is_size and np.isfinite(one.nominal):
                _add(nominal, "TargetValue", _decimal(one.nominal * _scale(one)))
            if one.description.kind in ("distance", "angle"):
                _add(nominal, "AnalysisMode", "THREEDIMENSIONAL")
            item = self._new(items, f"{tag}CharacteristicItem")
            _add(item, "Name", one.description.name)
            _references(item, "FeatureItemIds", [self._item_of[g] for g in groups if g in self._item_of])
            _add(item, "CharacteristicNominalId", nominal.attrib["id"])
            found.append(item.attrib["id"])
        return found

    def _zone(self, definition: ElementTree.Element, one: Decision) -> None:
        """Width of the zone, its datums and shape."""
        kind = one.description.kind
        _add(definition, "ToleranceValue", _decimal(1e3 * one.high))
        if one.description.datums:
            _add(definition, "DatumReferenceFrameId", self._frames[one.description.datums])
        first = _first_kind(self._inspection, one)
        has_axis = first in ("cylinder", "cone")
        if kind in ("parallelism", "perpendicularity", "angularity"):
            _add(definition, "MaterialCondition", "NONE")
            # The zone of an axis is measured in the directions that the datums leave.
            _add(_add(definition, "ZoneShape"), "DiametricalZone" if has_axis else "PlanarZone")
        elif kind == "position":
            _add(definition, "MaterialCondition", "NONE")
            shape = "DiametricalZone" if has_axis else "SphericalZone" if first == "sphere" else "NonDiametricalZone"
            _add(_add(definition, "ZoneShape"), shape)
        elif kind in ("coaxiality", "straightness"):
            _add(_add(definition, "ZoneShape"), "DiametricalZone")

    def _results(self, items: Sequence[str]) -> None:
        inspection = self._inspection
        results = self._new(_add(_add(self.root, "Results"), "MeasurementResultsSet", n="1"), "MeasurementResults")
        rule = inspection.description
        about = {"decision rule": rule.decision, "cloud": str(inspection.source.get("format", ""))}
        if rule.decision != "simple":
            about["probability of a verdict"] = f"{rule.probability:g}"
        _attributes(results, about)
        measured = _add(_add(results, "MeasuredCharacteristics"), "CharacteristicMeasurements", n=str(len(items)))
        for one, item in zip(inspection.decisions, items, strict=True):
            made = self._new(measured, f"{_type(inspection, one)}CharacteristicMeasurement")
            row = one.row()
            stated = {key: value for key, value in row.items() if key.startswith(_STATED) and value is not None}
            _attributes(made, {**stated, "verdict": one.verdict, "method": row["method"]})
            _add(_add(made, "Status"), "CharacteristicStatusEnum", _STATUS[one.verdict])
            _add(made, "CharacteristicItemId", item)
            if one.measured is not None:
                value = _add(made, "Value", _decimal(one.value * _scale(one)))
                value.set("combinedUncertainty", _decimal(one.uncertainty * _scale(one)))
                value.set("meanError", "0")  # the value is corrected for it
        verdicts = {one.verdict for one in inspection.decisions}
        whole = "FAIL" if "does not conform" in verdicts else "PASS" if verdicts == {"conforms"} else "UNKNOWN"
        _add(_add(results, "InspectionStatus"), "InspectionStatusEnum", whole)


def _add(parent: ElementTree.Element, tag: str, text: str = "", **attributes: str) -> ElementTree.Element:
    made = ElementTree.SubElement(parent, tag, attributes)
    if text:
        made.text = _NOT_XML.sub("\ufffd", text)
    return made


def _attributes(parent: ElementTree.Element, values: Mapping[str, object]) -> None:
    """Further statements by name: numbers and texts."""
    listed = _add(parent, "Attributes", n=str(len(values)))
    for name, value in values.items():
        text = value if isinstance(value, str) else repr(value)
        tag = "AttributeStr" if isinstance(value, str) else "AttributeD1"
        _add(listed, tag, name=name, value=_NOT_XML.sub("\ufffd", text))


def _references(parent: ElementTree.Element, tag: str, ids: Sequence[int]) -> None:
    if ids:
        listed = _add(parent, tag, n=str(len(ids)))
        for one in ids:
            _add(listed, "Id", str(one))


def _decimal(value: float) -> str:
    """A number without exponent, to 1e-9."""
    return f"{value:.9f}"


def _scale(one: Decision) -> float:
    return 180 / np.pi if one.description.kind == "angle" else 1e3


def _surfaces(inspection: Inspection, one: Decision) -> list[tuple[int, ...]]:
    own, _ = inspection.faces(one)
    return [tuple(group) for group in surfaces_of(inspection.part, own)]


def _type(inspection: Inspection, one: Decision) -> str:
    """Name of the kind in QIF."""
    is_sphere = one.description.kind in ("diameter", "radius") and _first_kind(inspection, one) == "sphere"
    return ("Spherical" if is_sphere else "") + _TYPES[one.description.kind]


def _first_kind(inspection: Inspection, one: Decision) -> str:
    return inspection.part.cad_faces[inspection.faces(one)[0][0]].kind


def _name(part: CadMesh, group: Sequence[int]) -> str:
    labels = dict.fromkeys(part.cad_faces[number].label or f"face {number}" for number in group)
    return ", ".join(labels)


def _limit(definition: ElementTree.Element, one: Decision) -> None:
    """Limit deviations of a size."""
    unit = "deg" if one.description.kind == "angle" else "mm"
    tolerance = _add(definition, "Tolerance")
    for tag, name in (("MaxValue", "upper"), ("MinValue", "lower")):
        value = getattr(one.description, f"{name}_{unit}")
        if value is not None:
            _add(tolerance, tag, _decimal(value))
    _add(tolerance, "DefinedAsLimit", "false")


def _define(definition: ElementTree.Element, feature: Feature) -> None:
    """Sizes of a feature."""
    face = feature.nominal
    assert face is not None
    if face.kind == "plane":
        return
    centres = feature.alone.vertices[feature.alone.faces].mean(1)
    outward = np.einsum("ij,ij->i", face.nearest(centres)[1], feature.alone.normals) @ feature.alone.areas
    _add(definition, "InternalExternal", "EXTERNAL" if outward > 0 else "INTERNAL")
    height = float((pose.inverse(face.part_from_face) @ feature.frame)[2, 3])  # of a cone, where its place is stated
    radius = face.radius + (height * np.tan(face.second) if face.kind == "cone" else 0.0)
    _add(definition, "Diameter", _decimal(2e3 * radius))
    if face.kind == "cone":
        _add(definition, "HalfAngle", _decimal(float(np.degrees(face.second))))


def _place(nominal: ElementTree.Element, feature: Feature) -> None:
    """Nominal place and direction of a feature."""
    frame = feature.frame
    point, direction = _numbers(1e3 * frame[:3, 3]), _numbers(frame[:3, 2])
    if feature.kind in ("cylinder", "cone"):
        axis = _add(nominal, "Axis")
        _add(axis, "AxisPoint", point)
        _add(axis, "Direction", direction)
        return
    _add(nominal, "Location", point)
    if feature.kind == "plane":
        _add(nominal, "Normal", direction)


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.9f}" for value in values)
