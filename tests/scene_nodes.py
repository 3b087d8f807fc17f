"""Nodes of the scene that a server of viser shows."""

from __future__ import annotations

from typing import Any

from scancell.nominal.cell import NominalCell


def visible_bodies(server: Any, folder: str, cell: NominalCell) -> tuple[str, ...]:
    """Names of the bodies of a cell whose nodes in a folder of the scene, such as ``/ghost``, are visible."""
    nodes = {body.name: server.scene.get_handle_by_name(f"{folder}/{body.name}") for body in cell.bodies}
    return tuple(name for name, node in nodes.items() if node is not None and node.visible)
