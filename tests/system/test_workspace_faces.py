"""Faces of a CAD part in the workspace: a click shows what they are, and an inspection colours them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import PARTS
from test_workspace import Opened

import scancell
from chromium import chromium
from scancell import Scanner
from scancell.browser.panels.faces import hit_face
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh, find_faces
from scancell.inspection.report import VERDICT_COLOURS
from tour import hosted, tab, waits

pytest.importorskip("OCP")

BLOCK = PARTS / "drilled_block.step"
NARROW = """
[[characteristic]]
name = "top"
kind = "flatness"
faces = ["top"]
tolerance_mm = {}

[[characteristic]]
name = "bottom"
kind = "flatness"
faces = ["bottom"]
tolerance_mm = 0.05
"""


ON_TOP = np.array([0.04, 0.02, 0.028])  # m, in the frame of the part


def on_screen(camera: Any, point: np.ndarray, box: dict[str, float]) -> tuple[float, float]:
    """Position, px, of a world point, m, in the page, whose canvas has a box."""
    rotation = pose.rotation_from_quaternion(np.asarray(camera.wxyz))
    x, y, z = rotation.T @ (point - np.asarray(camera.position))
    focal = box["height"] / 2 / np.tan(camera.fov / 2)
    return box["x"] + box["width"] / 2 + focal * x / z, box["y"] + box["height"] / 2 + focal * y / z


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as made:
        yield made


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Opened]:
    setup = load_setup(settings=["scan.max_profiles=60", "scan.sweep.enabled=false"])
    with (
        Scanner(setup=setup, threads=1) as scanner,
        hosted(scanner, BLOCK, WorkspaceSettings(tmp_path, "geometric")) as (host, server),
    ):
        assert host.workspace is not None
        host.workspace.feed.wanted = False
        yield Opened(host, server, tmp_path, browser)
    for context in browser.contexts:
        context.close()


@pytest.mark.parametrize("name", ["top", "slot_floor", "bore_a", "countersink"])
def test_rays_meet_the_faces_that_a_person_sees(name: str) -> None:
    part = scancell.load_part(BLOCK)
    assert isinstance(part, CadMesh)
    (number,) = find_faces(part, [name])
    rows = np.flatnonzero(part.cad_face == number)
    random = np.random.default_rng(0)
    for row in random.choice(rows, min(20, len(rows)), replace=False):
        middle, normal = part.vertices[part.faces[row]].mean(0), part.normals[row]
        assert hit_face(part, middle + 1e-3 * normal, -normal) == number
        assert hit_face(part, middle + 1.0 * normal, normal) is None


def test_a_click_selects_a_face_and_an_inspection_colours_it(opened: Opened, tmp_path: Path) -> None:
    page, faces, server = opened.page().page, opened.workspace.faces, opened.server
    assert faces is not None
    tab(page, "Scan")
    page.get_by_text("Click a face of the part.").wait_for()

    def clicked() -> bool:
        (client,) = server.get_clients().values()
        point = pose.transform_points(opened.state.world_from_body["part"], ON_TOP[None])[0]
        box = page.locator("canvas").first.bounding_box()
        page.mouse.click(*on_screen(client.camera, point, box))
        return faces.selected is not None

    waits(page, clicked, "the face that is clicked")
    assert faces.part.cad_faces[faces.selected or 0].label == "top"
    page.get_by_text("flatness top, flatness").wait_for()

    # A zone far below the noise cannot be decided.
    for tolerance, verdict in ((0.05, "conforms"), (0.00001, "cannot be decided")):
        faces.take(NARROW.format(tolerance).encode())
        if tolerance == 0.05:
            page.get_by_role("button", name="Scan the part").click()
            waits(page, lambda: not opened.workspace.scans.lack, "the scan")
        page.get_by_role("button", name="Inspect the scan").click()
        waits(page, lambda: faces.inspection is not None, "the inspection")
        page.locator("b", has_text=verdict).first.wait_for()
        nodes = [server.scene.get_handle_by_name(f"/frames/part/faces/{number}") for number in range(2)]
        # The top is selected; no view sees the bottom.
        assert tuple(bytes.fromhex(VERDICT_COLOURS["not evaluated"][1:])) in {node.color for node in nodes}
