"""Contents of HTML pages that need no network: templates filled with text, tables, meshes and packed arrays."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.files import atomic_write
from scancell.geometry.mesh import Mesh, clustered

_MANY_FACES = 25_000  # from which on a mesh is shown by a coarser one
_CELLS = 120  # of that mesh along the largest extent
_WEBGL, STYLE = Path(__file__).with_name("webgl.js"), Path(__file__).with_name("page.css")
_PLACE = re.compile(r"@([A-Z]+)@")


def write_filled(template: Path, out: str | Path, **texts: str) -> int:
    """Write a template with ``@NAME@`` replaced by texts, and return bytes.

    ``@WEBGL@`` are the functions of 3D pages, and ``@STYLE@`` is the style of all reports.

    Raises `OutputError` if the file cannot be written.
    """
    texts |= {"WEBGL": _WEBGL.read_text(encoding="utf-8"), "STYLE": STYLE.read_text(encoding="utf-8")}
    text = _PLACE.sub(lambda found: texts[found[1]], template.read_text(encoding="utf-8"))
    with atomic_write(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return len(text.encode("utf-8"))


def script_data(content: Any) -> str:
    """Plain data as JSON that cannot end the script element which holds it."""
    return json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")


def table(head: Sequence[str], rows: Iterable[Sequence[Any]], row_attributes: Sequence[str] = ()) -> str:
    """An HTML table of texts, which are escaped, and figures as of `format_figure`."""
    titles = "".join(f"<th>{html.escape(title)}</th>" for title in head)
    lines = []
    for number, row in enumerate(rows):
        attributes = f" {row_attributes[number]}" if row_attributes else ""
        cells = "".join(
            f"<td>{html.escape(value)}</td>" if isinstance(value, str) else f'<td class="n">{format_figure(value)}</td>'
            for value in row
        )
        lines.append(f"<tr{attributes}>{cells}</tr>")
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def format_figure(value: Any) -> str:
    """A number with four digits, a list of numbers as an interval, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, list | tuple):
        return " … ".join(map(format_figure, value))
    if isinstance(value, int) or abs(value) >= 1e4:
        return f"{value:,.0f}"
    return f"{value:.4g}"


def displayed(mesh: Mesh) -> Mesh:
    """The mesh, coarser where it has many faces."""
    if len(mesh.faces) <= _MANY_FACES:
        return mesh
    return clustered(mesh, float(np.ptp(mesh.bounds, axis=0).max()) / _CELLS)


def packed_mesh(mesh: Mesh) -> dict[str, Any]:
    """Vertices and faces of the `displayed` mesh."""
    mesh = displayed(mesh)
    return {**quantised(mesh.vertices, "vertices"), "faces": packed(mesh.faces, "<u4")}


def quantised(points: Array, name: str) -> dict[str, Any]:
    """Points (n, 3) as 16-bit shares of their bounding box."""
    low = points.min(0) if len(points) else np.zeros(3)
    size = np.maximum(points.max(0) - low, 1e-9) if len(points) else np.ones(3)
    return {"low": low.tolist(), "size": size.tolist(), name: packed(np.rint((points - low) / size * 65535), "<u2")}


def packed(values: ArrayLike, kind: str) -> str:
    """An array in Base64."""
    return base64.b64encode(np.asarray(values).astype(kind).tobytes()).decode("ascii")
