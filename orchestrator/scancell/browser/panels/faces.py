"""Faces of a CAD part in the workspace: a click selects one; its characteristics, and the verdicts of an inspection."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import RLock
from typing import Any

import numpy as np

from scancell.api import inspect
from scancell.arrays import Array
from scancell.browser.panels.handles import WARNING, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.panels.scans import Scans
from scancell.browser.scene.bodies import Rgb
from scancell.browser.scene.scene import CellScene
from scancell.config.inspection import CharacteristicDescription, InspectionDescription
from scancell.errors import CommandError, DescriptionError, MeshError
from scancell.geometry.cad import CadMesh, find_faces
from scancell.geometry.mesh import Mesh
from scancell.inspection.inspection import Decision, Inspection, limits_text, loaded_description, value_text
from scancell.inspection.report import SEVERITY, VERDICT_COLOURS
from scancell.live.state import LiveState
from scancell.results import ScanResult

_SELECTED = (40, 115, 225)
_TOML = ".toml,application/toml"


class PartFaces:
    """Selected face, characteristics and verdicts of a part; all browsers see the same. All methods are thread-safe.

    Parameters
    ----------
    part
        The CAD part.
    scene
        Shows it, and reports clicks on it.
    scan
        Returns the scan to inspect; raises `CommandError` if there is none.

    Attributes
    ----------
    selected
        Number of the selected face, from 0; None before a click.
    inspection
        The last inspection; None before.
    problem
        Why there are no characteristics or verdicts; empty if there are.
    """

    def __init__(self, part: CadMesh, scene: CellScene, scan: Callable[[], ScanResult]) -> None:
        self.part, self._scene, self._scan, self._lock = part, scene, scan, RLock()
        self._description: InspectionDescription | None = None
        self.selected: int | None = None
        self.inspection: Inspection | None = None
        self.problem = ""
        try:
            self._description = loaded_description(None, part)[0]
        except DescriptionError as error:
            self.problem = str(error)
        scene.on_part_click(self._pick)

    def take(self, content: bytes) -> None:
        """Take the characteristics of a file (TOML) by its content.

        Raises `DescriptionError` if they are none, or of another part.
        """
        with TemporaryDirectory() as folder:
            file = Path(folder) / "characteristics.toml"
            file.write_bytes(content)
            description = InspectionDescription.from_toml(file)
        named = [(one.name, (*one.faces, *one.to)) for one in description.characteristic]
        for name, words in (*named, *((datum.name, datum.faces) for datum in description.datum)):
            try:
                find_faces(self.part, words)
            except MeshError as error:
                raise DescriptionError(str(error), key=f"faces of '{name}'") from None
        with self._lock:
            self._description, self.inspection, self.problem = description, None, ""
            self._show()

    def inspect(self) -> None:
        """Inspect the scan.

        Raises `CommandError` without a scan or characteristics; `FitError` if the cloud cannot be aligned.
        """
        if self._description is None:
            raise CommandError(self.problem)
        found = inspect(self._scan(), self.part, self._description)
        with self._lock:
            self.inspection = found
            self._show()

    def characteristics(self, face: int) -> list[tuple[CharacteristicDescription, Decision | None]]:
        """Characteristics of a face, with their decisions where the part was inspected."""
        if self._description is None:
            return []
        decisions = {} if self.inspection is None else {d.description.name: d for d in self.inspection.decisions}
        return [
            (one, decisions.get(one.name))
            for one in self._description.characteristic
            if face in find_faces(self.part, (*one.faces, *one.to))
        ]

    def _pick(self, origin: Array, direction: Array) -> None:
        """Select the face that a ray in the frame of the part meets first."""
        face = hit_face(self.part, origin, direction)
        if face is not None:
            with self._lock:
                self.selected = face
                self._show()

    def _show(self) -> None:
        colours: dict[int, Rgb] = {}
        if self.inspection is not None:
            for one in sorted(self.inspection.decisions, key=lambda one: SEVERITY.index(one.verdict)):
                red, green, blue = bytes.fromhex(VERDICT_COLOURS[one.verdict][1:])
                colours |= dict.fromkeys(self.inspection.faces(one)[0], (red, green, blue))
        if self.selected is not None:
            colours[self.selected] = _SELECTED
        part = self.part
        groups = {}
        for colour in sorted(set(colours.values())):
            own = np.isin(part.cad_face, [face for face, other in colours.items() if other == colour])
            groups[colour] = Mesh(part.vertices, part.faces[own], part.source)
        self._scene.paint_faces(groups)


def hit_face(part: CadMesh, origin: Array, direction: Array) -> int | None:
    """Number of the face that a ray, (3,) and (3,), m, meets first; None if it misses the part."""
    a, b, c = np.moveaxis(part.vertices[part.faces], 1, 0)
    along, across = b - a, c - a
    normal = np.cross(direction, across)
    determinant = (along * normal).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = origin - a
        u = (away * normal).sum(1) / determinant
        other = np.cross(away, along)
        v, distance = other @ direction / determinant, (across * other).sum(1) / determinant
        met = (np.abs(determinant) > 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    if not met.any():
        return None
    return int(part.cad_face[np.argmin(np.where(met, distance, np.inf))])


def face_html(faces: PartFaces) -> str:
    """The selected face with its characteristics, and the counts of verdicts."""
    lines = []
    if faces.inspection is not None:
        counts = [
            f'<b style="color:{VERDICT_COLOURS[verdict]}">{count} {verdict}</b>'
            for verdict, count in faces.inspection.counts.items()
        ]
        lines.append(", ".join(counts))
    elif faces.problem:
        lines.append(f'<span style="color:{WARNING}">{escape(faces.problem)}</span>')
    if faces.selected is None:
        return small_html([*lines, "Click a face of the part."])
    face = faces.part.cad_faces[faces.selected]
    size = f", radius {1e3 * face.radius:.10g} mm" if face.radius else ""
    lines.append(f"<b>{escape(face.label or 'face')}</b> (number {faces.selected}): {face.kind}{size}")
    found = faces.characteristics(faces.selected)
    for one, decision in found:
        text = f"{escape(one.name)}, {one.kind.replace('_', ' ')}"
        if decision is not None:
            about = escape(f"{value_text(decision)}; {limits_text(decision)}").replace(" um", " µm")
            text += f': <b style="color:{VERDICT_COLOURS[decision.verdict]}">{decision.verdict}</b><br>{about}'
        lines.append(text)
    return small_html([*lines, *([] if found else ["no characteristics"])])


class FacesPanel:
    """Shows the selected face of a CAD part, takes characteristics, and inspects the scan."""

    def __init__(self, gui: Any, operator: OperatorCommands, faces: PartFaces, scans: Scans) -> None:
        self._faces = faces
        self._text = gui.add_html("")
        upload = gui.add_upload_button("Open characteristics (TOML)", mime_type=_TOML)
        operator.connect(upload, lambda: faces.take(upload.value.content))
        operator.connect(gui.add_button("Inspect the scan"), faces.inspect, lambda _: scans.lack or faces.problem)

    def show(self, state: LiveState) -> None:
        """Show the selected face."""
        set_changed(self._text, "content", face_html(self._faces))
