"""Terminals: inputs and outputs as plugs, so that a tool connects `command` or `measured` as a whole."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

# The icon fills a square of 20 mm.
_HALF_SIZE = "100"
_SCALE_TO_MM = "0.1"


@dataclass
class _Terminal:
    """Members by their last name; a name may be that of a member and of a terminal inside."""

    members: dict[str, str] = field(default_factory=dict)
    inside: dict[str, _Terminal] = field(default_factory=dict)

    def add(self, path: list[str], name: str) -> None:
        if len(path) == 1:
            self.members[path[0]] = name
        else:
            self.inside.setdefault(path[0], _Terminal()).add(path[1:], name)

    def write(self, parent: ET.Element) -> None:
        """Members first, as the schema requires."""
        for member, name in self.members.items():
            attributes = {"variableName": name, "memberName": member, "variableKind": "signal"}
            ET.SubElement(parent, "TerminalMemberVariable", attributes)
        for name, terminal in self.inside.items():
            terminal.write(ET.SubElement(parent, "Terminal", {"name": name, "matchingRule": "plug"}))


def terminals_xml(variables: Iterable[Any]) -> bytes:
    """`terminalsAndIcons.xml` of FMI 3.

    The structured names give the tree: ``command.trigger.mode`` is the member ``mode`` of the terminal ``trigger``
    in the terminal ``command``.

    Parameters
    ----------
    variables
        As FMPy reads them; those that are neither inputs nor outputs are left out.
    """
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    graphics = ET.SubElement(root, "GraphicalRepresentation")
    corners = {"x1": f"-{_HALF_SIZE}", "y1": f"-{_HALF_SIZE}", "x2": _HALF_SIZE, "y2": _HALF_SIZE}
    ET.SubElement(graphics, "CoordinateSystem", {**corners, "suggestedScalingFactorTo_mm": _SCALE_TO_MM})
    ET.SubElement(graphics, "Icon", corners)
    all_of_them = _Terminal()
    for variable in variables:
        if variable.causality in ("input", "output"):
            all_of_them.add(variable.name.split("."), variable.name)
    all_of_them.write(ET.SubElement(root, "Terminals"))
    ET.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root) + b"\n"
