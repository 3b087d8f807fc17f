"""Characteristics from the annotations of a CAD file (semantic PMI of AP242)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, get_args

import numpy as np

from scancell.config.description import validate
from scancell.config.inspection import CharacteristicKind, InspectionDescription, SizeKind
from scancell.geometry.cad import Annotation, CadMesh
from scancell.inspection.features import is_one_surface

_KINDS = {"concentricity": "coaxiality", "run_out": "circular_run_out"}
_HARMLESS = ("all_around", "all_over")  # modifiers that the faces of the annotation state already
_UNTOLERANCED = ("theoretical", "auxiliary", "reference")


def annotated(part: CadMesh) -> tuple[InspectionDescription | None, list[str]]:
    """Description by the annotations of a part, None if they state none; and those not inspected, with reasons."""
    datums = {one.name: one for one in part.annotations if one.kind == "datum" and one.faces}
    rows: list[dict[str, Any]] = []
    left: list[str] = []
    for one in part.annotations:
        if one.kind == "datum":
            if not one.faces:
                left.append(f"datum {one.name}: no faces")
            continue
        try:
            rows += _rows(part, one, list(datums))
        except _LeftError as reason:
            left.append(f"{_title(one)}: {reason}")
    if not rows:
        return None, left
    named = Counter(row["name"] for row in rows)
    seen: Counter[str] = Counter()
    for row in rows:
        if named[name := row["name"]] > 1:
            seen[name] += 1
            row["name"] = f"{name} {seen[name]}"
    used = {letter for row in rows for letter in row.get("datums", ())}
    described = [{"name": name, "faces": _words(part, datums[name].faces)} for name in datums if name in used]
    content = {"datum": described, "characteristic": rows}
    return validate(InspectionDescription, content, f"annotations of {part.source}"), left


class _LeftError(Exception):
    """Why an annotation is not inspected."""


def _title(one: Annotation) -> str:
    return one.name if one.name.replace(" ", "_") == one.kind or not one.name else f"{one.name} ({one.kind})"


def _rows(part: CadMesh, one: Annotation, datums: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Characteristics of an annotation: one for each surface, where it states several features at once."""
    _refuse(one, datums)
    kind, groups = _KINDS.get(one.kind, one.kind), surfaces_of(part, one.faces)
    if kind == "size":
        kinds = {part.cad_faces[group[0]].kind for group in groups}
        if not kinds <= {"cylinder", "sphere"} and not (len(groups) == 2 and kinds == {"plane"}):
            raise _LeftError("a size of neither cylinders nor two planes")
        kind = "distance" if kinds == {"plane"} else "diameter"
    if kind not in get_args(CharacteristicKind):
        raise _LeftError("not evaluated")
    row: dict[str, Any] = {"name": one.name or kind, "kind": kind, **_limits(kind, one)}
    if kind in ("distance", "angle", "symmetry"):
        second = list(one.second_faces)
        if not second and len(groups) == 2:
            groups, second = groups[:1], groups[1]
        if not second:
            raise _LeftError("one feature where two are needed")
        row["to"] = tuple(second)
    elif kind == "surface_profile":
        groups = [list(one.faces)]
    if "to" in row:
        row["to"] = _words(part, row["to"])
    for group in groups:
        words = _words(part, group)
        label, name = ", ".join(word for word in words if isinstance(word, str)), row["name"]
        yield {**row, "faces": words, "name": name if label in name else f"{name}, {label}"}


def _words(part: CadMesh, faces: Sequence[int]) -> tuple[int | str, ...]:
    """Labels of faces, if they name these faces alone, else their numbers."""
    labels = {part.cad_faces[number].label for number in faces}
    if "" not in labels and {n for n, face in enumerate(part.cad_faces) if face.label in labels} == set(faces):
        return tuple(sorted(labels))
    return tuple(faces)


def _refuse(one: Annotation, datums: Sequence[str]) -> None:
    """Refuse what is not understood."""
    if wrong := [word for word in one.modifiers if word not in _HARMLESS]:
        raise _LeftError("without tolerance" if wrong[0] in _UNTOLERANCED else wrong[0].replace("_", " "))
    if not one.faces:
        raise _LeftError("no faces")
    if unknown := [name for name in one.datums if name not in datums]:
        raise _LeftError(f"datum {unknown[0]} has no faces of the part")
    if len(one.datums) > 3:
        raise _LeftError("more than three datums")


def _limits(kind: str, one: Annotation) -> dict[str, Any]:
    """Limits of a size, or tolerance and datums."""
    if kind not in get_args(SizeKind):
        if one.value is None or one.value <= 0:
            raise _LeftError("without width of its zone")
        return {"tolerance_mm": round(1e3 * one.value, 9), "datums": one.datums}
    if one.lower is None and one.upper is None:
        raise _LeftError("without tolerance")
    unit, scale = ("deg", 180 / np.pi) if kind == "angle" else ("mm", 1e3)
    values = {"nominal": one.value, "lower": one.lower, "upper": one.upper}
    return {f"{name}_{unit}": round(scale * value, 9) for name, value in values.items() if value is not None}


def surfaces_of(part: CadMesh, faces: Sequence[int]) -> list[list[int]]:
    """Groups of faces, each of one surface."""
    groups: list[list[int]] = []
    for number in faces:
        face = part.cad_faces[number]
        own = next((group for group in groups if is_one_surface(part.cad_faces[group[0]], face)), None)
        if own is None:
            groups.append([number])
        else:
            own.append(number)
    return groups


def face_rows(part: CadMesh) -> list[dict[str, Any]]:
    """Number, kind, label, centre, size and solid of each face, as plain data."""
    centres = part.vertices[part.faces].mean(1) * part.areas[:, None]
    total = np.bincount(part.cad_face, part.areas, len(part.cad_faces))
    safe = np.where(total > 0, total, 1.0)
    middle = np.stack([np.bincount(part.cad_face, column, len(part.cad_faces)) / safe for column in centres.T], 1)
    return [
        {
            "number": number,
            "kind": face.kind,
            "label": face.label,
            "solid": face.name,
            "centre_mm": [round(1e3 * value, 4) for value in middle[number].tolist()],
            "radius_mm": round(1e3 * face.radius, 6),
            "area_mm2": round(1e6 * float(total[number]), 4),
        }
        for number, face in enumerate(part.cad_faces)
    ]
