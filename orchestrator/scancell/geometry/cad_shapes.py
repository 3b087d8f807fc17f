"""Shapes and labels of Open CASCADE, for the process that reads CAD files (`scancell.geometry.cad_kernel`)."""

from __future__ import annotations

from collections import defaultdict
from typing import Any


class ByShape:
    """Values of shapes, wherever these are placed."""

    def __init__(self) -> None:
        self._known: dict[int, list[tuple[Any, Any]]] = defaultdict(list)

    def add(self, shape: Any, value: Any) -> None:
        """Give a shape a value; it keeps those that it has."""
        self._known[_key(shape)].append((shape, value))

    def of(self, shape: Any) -> list[Any]:
        """Values of a shape."""
        return [value for known, value in self._known.get(_key(shape), ()) if known.IsPartner(shape)]


def labels(list_into: Any, *of: Any) -> list[Any]:
    """Labels that a function of the kernel appends to a sequence."""
    from OCP.collections import Sequence_TDF_Label  # noqa: PLC0415

    sequence = Sequence_TDF_Label()
    list_into(*of, sequence)
    return [sequence.Value(i) for i in range(1, sequence.Length() + 1)]


def _key(shape: Any) -> int:
    """Hash of a shape that does not depend on its place."""
    from OCP.TopLoc import TopLoc_Location  # noqa: PLC0415

    return hash(shape.Located(TopLoc_Location()))


def name_of(label: Any) -> str:
    """Name of a label; "" if it has none."""
    from OCP.TDataStd import TDataStd_Name  # noqa: PLC0415

    # Looking for an attribute that is not there can end the process.
    if not label.IsAttribute(TDataStd_Name.GetID_s()):
        return ""
    found = TDataStd_Name()
    label.FindAttribute(TDataStd_Name.GetID_s(), found)
    return str(found.Get().ToExtString())


def shapes_in(shape: Any, kind: Any) -> list[Any]:
    """All shapes of a kind in a shape, in their places."""
    from OCP.TopExp import TopExp_Explorer  # noqa: PLC0415

    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def faces_in(shape: Any) -> list[Any]:
    """All faces in a shape, in their places."""
    from OCP.TopAbs import TopAbs_ShapeEnum  # noqa: PLC0415
    from OCP.TopoDS import TopoDS  # noqa: PLC0415

    return [TopoDS.Face(face) for face in shapes_in(shape, TopAbs_ShapeEnum.TopAbs_FACE)]
