"""What stands on the table, and pictures of it."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path, PurePath
from typing import Any

from PIL import Image

from scancell.errors import DescriptionError
from scancell.workspace.browser.desk import Desk
from scancell.workspace.live_state import LiveState

_UNITS = ("mm", "m", "inch")
_SUFFIXES = (".stl", ".obj", ".ply")
_PICTURE = (720, 1280)  # px, height and width

OpenPart = Callable[[str, bytes, str], None]


class FilePanel:
    """Opens another part, and saves pictures.

    Parameters
    ----------
    open_part
        Receives the name of a mesh file, its content and its unit.
    """

    def __init__(self, gui: Any, desk: Desk, open_part: OpenPart) -> None:
        self._desk, self._open_part = desk, open_part
        self._unit = gui.add_dropdown("unit of the mesh", _UNITS)
        self._upload = gui.add_upload_button("Open a part (STL, OBJ, PLY)", mime_type=",".join(_SUFFIXES))
        picture = gui.add_button("Download a picture")
        self._upload.on_upload(desk.by_person(lambda: desk.as_operator(self._open)))
        picture.on_click(desk.by_person(self._take_picture))
        desk.add_inputs([self._unit, self._upload])

    def show(self, state: LiveState) -> None:
        """Nothing here depends on the state."""

    def _open(self) -> None:
        file = self._upload.value
        name = PurePath(file.name).name
        if Path(name).suffix.lower() not in _SUFFIXES:
            raise DescriptionError(f"{name}: expected a mesh file, {', '.join(_SUFFIXES)}")
        self._open_part(name, file.content, self._unit.value)

    def _take_picture(self) -> None:
        pixels = self._desk.render(*_PICTURE)
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "PNG")
        self._desk.send_file("scancell.png", file.getvalue())
