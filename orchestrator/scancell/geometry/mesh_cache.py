"""Meshes of parts, kept between uses."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path

from scancell.errors import MeshError
from scancell.geometry.mesh import Mesh, load_mesh

_MOST = 2


class MeshCache:
    """Meshes from files; the two used last are kept."""

    def __init__(self) -> None:
        self._meshes: OrderedDict[tuple[str, str, int, int], Mesh] = OrderedDict()

    def mesh(self, part: str | Path | Mesh, unit: str) -> Mesh:
        """The mesh in metres of a file in `unit`, or the mesh itself; a file is read again only when it has changed.

        Raises
        ------
        MeshError
            If the file is missing, unreadable, empty or broken.
        """
        if isinstance(part, Mesh):
            if not len(part.faces):
                raise MeshError(f"{part.source or 'mesh'}: has no faces")
            return part
        path = Path(part)
        status = path.stat() if path.is_file() else None
        key = (str(path.absolute()), unit, status.st_mtime_ns if status else 0, status.st_size if status else 0)
        if key not in self._meshes:
            self._meshes[key] = load_mesh(path, unit)
        self._meshes.move_to_end(key)
        if len(self._meshes) > _MOST:
            self._meshes.popitem(last=False)
        return self._meshes[key]

    def clear(self) -> None:
        """Forget all meshes."""
        self._meshes.clear()
