"""Results of inspections as QIF 3.0 documents: content, references, and the public schemas where they are at hand."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from inspection_parts import cad_part, cloud_of
from scancell.config.inspection import InspectionDescription
from scancell.geometry import pose
from scancell.geometry.cad import CadFace
from scancell.geometry.shapes import Box, PlacedShape, Ring, Sphere
from scancell.inspection.inspection import Inspection, inspect_part
from scancell.inspection.qif import QIF_NAMESPACE, write_qif

_SCHEMAS = Path(os.environ.get("SCANCELL_QIF", Path(__file__).parents[2] / "build/qif-community"))
_PART = cad_part(
    [
        PlacedShape("block", Box(0.08, 0.05, 0.02), np.eye(4)),
        PlacedShape("ring", Ring(5e-3, 9e-3, 12e-3), pose.translation([0.06, 0.004, 0.003])),
        PlacedShape("ball", Sphere(0.006), pose.translation([-0.06, 0.001, 0.002])),
    ]
)
_BORE, _OUTSIDE, _BALL = 6, 9, 10
_SIZE = {"upper_mm": 0.01, "lower_mm": -0.01}
_ZONE = {"tolerance_mm": 0.02}
_LISTED: list[dict[str, Any]] = [
    {"kind": "diameter", "faces": [_BORE], **_SIZE},
    {"kind": "diameter", "faces": [_BALL], "upper_mm": 0.01},
    {"kind": "radius", "faces": [_BALL], "lower_mm": -0.01},
    {"kind": "radius", "faces": [_OUTSIDE], **_SIZE, "nominal_mm": 9.5},
    {"kind": "distance", "faces": [4], "to": [5], **_SIZE},
    {"kind": "angle", "faces": [0], "to": [2], "upper_deg": 0.01, "lower_deg": -0.01},
    {"kind": "flatness", "faces": [4], **_ZONE},
    {"kind": "roundness", "faces": [_BORE], **_ZONE},
    {"kind": "roundness", "faces": [_BALL], **_ZONE},
    {"kind": "cylindricity", "faces": [_OUTSIDE], **_ZONE},
    {"kind": "straightness", "faces": [_BORE], **_ZONE},
    {"kind": "parallelism", "faces": [5], "datums": ["A"], **_ZONE},
    {"kind": "perpendicularity", "faces": [_BORE], "datums": ["A"], **_ZONE},
    {"kind": "angularity", "faces": [0], "datums": ["A", "the C"], **_ZONE},
    {"kind": "position", "faces": [_BORE], "datums": ["A", "B", "the C"], **_ZONE},
    {"kind": "position", "faces": [_BALL], "datums": ["A", "B", "the C"], **_ZONE},
    {"kind": "position", "faces": [5], "datums": ["A", "B", "the C"], **_ZONE},
    {"kind": "coaxiality", "faces": [_OUTSIDE], "datums": ["D"], **_ZONE},
    {"kind": "symmetry", "faces": [2], "to": [3], "datums": ["A", "D", "B"], **_ZONE},
    {"kind": "circular_run_out", "faces": [_OUTSIDE], "datums": ["D"], **_ZONE},
    {"kind": "total_run_out", "faces": [_OUTSIDE], "datums": ["D"], **_ZONE},
    {"kind": "surface_profile", "faces": [0, 1, 2], "datums": ["A", "B", "the C"], **_ZONE},
    {"kind": "surface_profile", "faces": [0, 2, _BORE], **_ZONE},
    {"kind": "flatness", "faces": [_BORE], **_ZONE},  # not evaluated
]
_DATUMS = [
    {"name": "A", "faces": [4]},
    {"name": "B", "faces": [0]},
    {"name": "the C", "faces": [2]},
    {"name": "D", "faces": [_BORE]},
]


def _inspected(listed: list[dict[str, Any]], **keys: Any) -> Inspection:
    named = [{"name": f'{number} <{one["kind"]}> & "é"\u0001', **one} for number, one in enumerate(listed)]
    described = InspectionDescription.model_validate({"datum": _DATUMS, "characteristic": named, **keys})
    changes = {_OUTSIDE: lambda local, normal: local + 60e-6 * normal}
    return inspect_part(_PART, cloud_of(_PART, 6000, 1, 2e-6, changes), described, align="none")


@pytest.fixture(scope="module")
def inspection() -> Inspection:
    return _inspected(_LISTED)


def _read(inspection: Inspection, folder: Path) -> ElementTree.Element:
    write_qif(inspection, folder / "inspection.qif")
    return ElementTree.parse(folder / "inspection.qif").getroot()


def _of(root: ElementTree.Element, path: str) -> list[ElementTree.Element]:
    return root.findall(path, {"": QIF_NAMESPACE})


def _value(one: ElementTree.Element, tag: str) -> str:
    return one.findtext(tag, "", {"": QIF_NAMESPACE})


def test_measured_values_are_those_of_the_inspection(inspection: Inspection, tmp_path: Path) -> None:
    root = _read(inspection, tmp_path)
    status = {"PASS": "conforms", "FAIL": "does not conform", "INDETERMINATE": "cannot be decided"}
    measured = _of(root, ".//CharacteristicMeasurements/*")
    assert len(measured) == len(_LISTED)
    for one, row in zip(measured, inspection.figures["characteristics"], strict=True):
        stated = _value(one, "Status/CharacteristicStatusEnum")
        assert status.get(stated, "not evaluated") == row["verdict"]
        (value,) = _of(one, "Value") or [None]
        unit, fine, scale = ("deg", "deg", 1.0) if row["kind"] == "angle" else ("mm", "um", 1e3)
        if value is None:
            assert row[f"value_{unit}"] is None and stated == "NOT_ANALYZED"
            continue
        assert float(value.text or "") == pytest.approx(row[f"value_{unit}"], abs=1e-9)
        assert scale * float(value.attrib["combinedUncertainty"]) == pytest.approx(row[f"uncertainty_{fine}"], abs=1e-6)
    assert {_value(one, "Status/CharacteristicStatusEnum") for one in measured} >= {"PASS", "FAIL", "NOT_ANALYZED"}
    assert [one.text for one in _of(root, ".//InspectionStatusEnum")] == ["FAIL"]


def test_references_lead_to_elements_and_counts_are_right(inspection: Inspection, tmp_path: Path) -> None:
    root = _read(inspection, tmp_path)
    by_id = {one.attrib["id"]: one.tag.split("}")[1] for one in root.iter() if "id" in one.attrib}
    assert len(by_id) == sum("id" in one.attrib for one in root.iter()) == int(root.attrib["idMax"])
    for one in root.iter():
        if "n" in one.attrib:
            assert int(one.attrib["n"]) == len(one)
        tag = one.tag.split("}")[1]
        if tag.endswith("Id") and tag not in ("QPId", "Id"):
            of = {"FormalStandardId": "Standard"}.get(tag, tag.removesuffix("Id"))
            assert by_id[one.text or ""].endswith(of), tag
    for kind in ("Nominal", "Item"):
        ids = _of(root, f".//Feature{kind}Ids/Id")
        assert ids and all(by_id[one.text or ""].endswith(f"Feature{kind}") for one in ids)


def test_features_are_those_of_the_part(inspection: Inspection, tmp_path: Path) -> None:
    root = _read(inspection, tmp_path)
    sizes = [
        (_value(one, "InternalExternal"), float(_value(one, "Diameter")))
        for one in _of(root, ".//FeatureDefinitions/*")
        if one.tag.endswith("CylinderFeatureDefinition")
    ]
    assert sorted(sizes) == [("EXTERNAL", 18.0), ("INTERNAL", 10.0)]
    axes = [_value(one, "Axis/AxisPoint").split() for one in _of(root, ".//CylinderFeatureNominal")]
    assert np.array(axes, float) == pytest.approx(np.array([[60.0, 4.0, 3.0]] * 2), abs=1e-6)
    targets = [float(one.text or "") for one in _of(root, ".//TargetValue")]
    assert targets == pytest.approx([10.0, 12.0, 6.0, 9.5, 20.0, 90.0], abs=1e-6)


def test_the_same_inspection_makes_the_same_bytes(tmp_path: Path) -> None:
    _read(_inspected(_LISTED[:3]), tmp_path)
    first = (tmp_path / "inspection.qif").read_bytes()
    _read(_inspected(_LISTED[:3]), tmp_path)
    assert (tmp_path / "inspection.qif").read_bytes() == first
    other = _read(_inspected(_LISTED[:3], probability=0.9), tmp_path)
    assert _value(other, "QPId").encode() not in first


@pytest.mark.parametrize(
    ("listed", "keys"),
    [
        (None, {}),
        (_LISTED[:1], {"decision": "simple", "datum": []}),
        ([_LISTED[-1]], {}),
        ([{"kind": "perpendicularity", "faces": [5], "datums": ["A"], **_ZONE}], {}),
    ],
)
def test_documents_are_valid(
    inspection: Inspection, listed: list[dict[str, Any]] | None, keys: Mapping[str, Any], tmp_path: Path
) -> None:
    if not _SCHEMAS.is_dir():
        pytest.skip(f"no schemas of QIF 3 in {_SCHEMAS}: a checkout of qif-community, or SCANCELL_QIF")
    from bench.qif import faults, load_schema  # noqa: PLC0415  (needs lxml)

    _read(inspection if listed is None else _inspected(listed, **keys), tmp_path)
    assert faults(load_schema(_SCHEMAS), tmp_path / "inspection.qif") == []


def test_features_without_closed_form_have_no_nominal(tmp_path: Path) -> None:
    free = CadFace("bspline", np.eye(4))
    described = InspectionDescription.model_validate(
        {"characteristic": [{"name": "free", "kind": "surface_profile", "faces": [0], **_ZONE}]}
    )
    part = replace(_PART, cad_faces=(free, *_PART.cad_faces[1:]))
    root = _read(inspect_part(part, cloud_of(_PART, 3000, 1), described, align="none"), tmp_path)
    assert not _of(root, ".//Features") and len(_of(root, ".//CharacteristicMeasurements/*")) == 1
