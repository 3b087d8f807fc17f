"""The workspace of cells with axes beyond the table: it shows what they carry, moves, jogs and teaches them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from live_cells import SteppedCell
from test_program_panels import Gui, Page

viser = pytest.importorskip("viser")

from scancell import (  # noqa: E402
    CommandError,
    DescriptionError,
    LivePlan,
    LiveScan,
    MoveAxis,
    MoveJoints,
    Scanner,
    assets_dir,
    load_setup,
)
from scancell.browser.panels.cell_panel import JogPanel, JointPanel, PosePanel  # noqa: E402
from scancell.browser.scene.scene import CellScene  # noqa: E402
from scancell.browser.server.workspace import Workspace, WorkspaceSettings  # noqa: E402
from scancell.cell.driver import Operation  # noqa: E402
from scancell.geometry import pose  # noqa: E402
from scancell.live.state import SetOperation  # noqa: E402
from scancell.programs.program import run_program  # noqa: E402
from scancell.programs.taught import TaughtProgram, TaughtStep, program_text, read_program  # noqa: E402

PART = assets_dir() / "parts/step_block.stl"
CELLS = {"track": ("track, mm", 120.0, 0.12, "base"), "tilt_turn": ("tilt, deg", 15.0, np.radians(15.0), "table")}


@pytest.fixture(params=CELLS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def cell(name: str) -> Iterator[SteppedCell]:
    setup = load_setup(assets_dir() / f"cells/{name}.toml")
    with Scanner(setup=setup, threads=1) as scanner, scanner.session(PART, guarded=True) as session:
        yield SteppedCell(session)


@pytest.fixture
def page(cell: SteppedCell, tmp_path: Path) -> Page:
    return Page(cell, tmp_path)


@pytest.fixture
def server() -> Iterator[Any]:
    made = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield made
    made.stop()


class Sliders(Gui):
    """Also keeps the ends of sliders, and what a held button does."""

    def add_slider(self, name: str, low: float, high: float, _step: float, value: float) -> Any:
        return self._named(name, value, min=low, max=high)

    def add_button(self, name: str, **_: Any) -> Any:
        made = self._named(name)
        made.on_hold = lambda held, callback_hz: made.on_click(held)
        return made

    def add_command(self, *_: Any, **__: Any) -> Any:
        return SimpleNamespace(on_trigger=lambda _callback: None)


def settled(panel: JointPanel, cell: SteppedCell) -> None:
    """Let the change of a slider become due, and the motion end."""
    panel._debounce._delay = 0.0
    panel.show(cell.live.state)
    cell.cycle(4)
    cell.rests()
    panel.show(cell.live.state)


def test_slider_of_the_axis_moves_it_and_what_it_carries_in_the_scene(
    name: str, cell: SteppedCell, page: Page, server: Any
) -> None:
    label, value, position, carried = CELLS[name]
    scene = CellScene(server, cell.session.true, cell.session.world.setup.sensor, cell.session.world.setup.cell)
    gui = Sliders()
    panel = JointPanel(gui, page.operator, cell.live.state)
    (axis,) = cell.session.nominal.further_axes
    slider = gui.named[label]
    assert (slider.min, slider.max) == pytest.approx((axis.min / axis.per_unit, axis.max / axis.per_unit))
    before = cell.live.state
    scene.show(before)
    slider.enter(value)
    settled(panel, cell)
    after = cell.live.state
    assert after.further_axes == pytest.approx([position], abs=1e-5)
    assert after.joints == pytest.approx(before.joints, abs=1e-5)
    assert slider.value == pytest.approx(value, abs=0.11)
    scene.show(after)
    frame = next(body.moves_with for body in cell.session.nominal.bodies if body.name == carried)
    expected = cell.session.nominal.world_from(frame, after.axes)[:3, 3]
    assert scene.position(frame) == pytest.approx(expected, abs=1e-4)
    assert np.linalg.norm(expected - cell.session.nominal.world_from(frame, before.axes)[:3, 3]) > 0.02
    # A slider of a joint leaves the axis where it is.
    gui.named["joint 1, deg"].enter(gui.named["joint 1, deg"].value + 2.0)
    settled(panel, cell)
    assert cell.live.state.joints[0] == pytest.approx(before.joints[0] + np.radians(2.0), abs=1e-3)
    assert cell.live.state.further_axes == pytest.approx([position], abs=1e-5)


@pytest.mark.parametrize("name", ["fixed_table"])
def test_table_that_does_not_turn_has_no_slider_and_no_jog(cell: SteppedCell, page: Page) -> None:
    gui = Sliders()
    panel = JointPanel(gui, page.operator, cell.live.state)
    JogPanel(gui, page.operator, cell.live.state)
    assert gui.named["table, deg"].visible is False
    assert "table" not in gui.named["axis"].options
    gui.named["joint 1, deg"].enter(gui.named["joint 1, deg"].value + 2.0)
    before = cell.live.state
    settled(panel, cell)
    assert cell.live.state.joints[0] == pytest.approx(before.joints[0] + np.radians(2.0), abs=1e-3)
    cell.live.submit(SetOperation(Operation.MANUAL))
    cell.cycle(20)
    before = cell.live.state
    gui.named["axis"].value = "tool along z"  # what follows the table in the order of the axes
    for _ in range(20):
        gui.named["Hold to jog +"].enter()
        cell.cycle(2)
    cell.rests()
    assert np.abs(cell.live.state.joints - before.joints).max() > 1e-3


@pytest.mark.parametrize(("name", "lacks"), [("fixed_table", "table"), ("held_part", "scan line")])
def test_steps_that_a_cell_cannot_make_are_not_taught(lacks: str, page: Page) -> None:
    kinds = page.gui.named["kind"].options
    assert {"joints", "line", "scan line", "table", "wait"} - {*kinds} == {lacks}
    for kind in kinds:
        assert page.add(kind) == ""


def test_held_button_jogs_the_axis_alone(cell: SteppedCell, page: Page) -> None:
    (axis,) = cell.session.nominal.further_axes
    gui = Sliders()
    JogPanel(gui, page.operator, cell.live.state)
    cell.live.submit(SetOperation(Operation.MANUAL))
    cell.cycle(20)
    before = cell.live.state.axes
    gui.named["axis"].value = axis.name
    for _ in range(40):
        gui.named["Hold to jog -"].enter()
        cell.cycle(2)
    cell.rests()
    moved = cell.live.state.axes - before
    assert moved[-1] < -5e-3
    assert moved[:-1] == pytest.approx(0.0, abs=1e-5)
    assert "tool along x" in gui.named["axis"].options


def test_pose_of_the_tool_is_where_the_axis_carries_it(name: str, cell: SteppedCell, page: Page) -> None:
    (axis,) = cell.session.nominal.further_axes
    cell.live.submit(MoveAxis(axis.name, 0.2))
    cell.cycle(4)
    state = cell.rests()
    gui = Sliders()
    gui.add_vector3 = lambda label, value, **_: gui._named(label, value)  # type: ignore[attr-defined]
    gui.add_checkbox = lambda label, value, **_: gui._named(label, value)  # type: ignore[attr-defined]
    gizmo = SimpleNamespace(
        add_transform_controls=lambda *_, **__: SimpleNamespace(visible=False, on_update=lambda _: None)
    )
    PosePanel(gui, gizmo, page.operator, state)
    base = cell.session.nominal.world_from("base", state.axes)
    seen = pose.inverse(base) @ cell.session.world_from_tool()
    assert gui.named["x, y, z, mm"].value == pytest.approx(1e3 * seen[:3, 3], abs=0.02)
    gui.named["x, y, z, mm"].value = tuple(1e3 * seen[:3, 3] + [0.0, 0.0, 10.0])
    gui.named["Move to this pose"].enter()
    cell.cycle(4)
    cell.rests()
    reached = pose.inverse(base) @ cell.session.world_from_tool()
    assert reached[:3, 3] - seen[:3, 3] == pytest.approx([0.0, 0.0, 0.01], abs=1e-4)
    assert cell.live.state.further_axes == pytest.approx([0.2], abs=1e-4)
    assert page.messages == []


def test_taught_steps_bring_the_axis_back_to_where_they_were_taught(cell: SteppedCell, page: Page) -> None:
    (axis,) = cell.session.nominal.further_axes
    assert axis.name in page.gui.named["kind"].options
    page.add("joints", "first")
    assert page.steps == ["move_axis", "first"]
    cell.live.submit(MoveAxis(axis.name, 0.1))
    cell.cycle(4)
    cell.rests()
    assert page.add("joints", "second") == ""
    assert page.add("joints", "third") == ""
    assert page.steps == ["move_axis", "first", "move_axis", "second", "third"]
    assert page.add(axis.name) == ""
    assert page.steps[-1] == "move_axis"
    text = page.taught.text
    shown = {"mm": "100 * mm", "deg": f"{np.degrees(0.1):.4f}"}[axis.unit]
    assert f'robot.move_axis("{axis.name}", {shown}' in text
    assert program_text(read_program(text, "taught.py")) == text
    page.select(1)
    page.press("this step", "Move to")
    cell.cycle(4)
    cell.rests()
    assert cell.session.further_axes == pytest.approx([0.0], abs=1e-5)
    done = cell.live.perform(lambda session: run_program(page.taught.path, session, "geometric"), "the program")
    while not done.done():
        cell.cycle(1)
    done.result()
    assert cell.session.further_axes == pytest.approx([0.1], abs=1e-5)


def test_planned_motions_start_from_where_the_axis_is_and_scans_where_they_hold_it(cell: SteppedCell) -> None:
    (axis,) = cell.session.nominal.further_axes
    cell.live.submit(MoveAxis(axis.name, 0.05))
    cell.cycle(4)
    cell.rests()
    goal = np.append(cell.session.home + 0.05, 0.3)
    moved = LivePlan(cell.live, cell.session).go_to(goal, "a pose near home")
    while not moved.done():
        cell.cycle(1)
    moved.result()
    assert cell.session.commanded == pytest.approx([*goal, 0.05], abs=1e-9)
    scan = LiveScan("geometric")
    scan.start(cell.live)
    while not scan.result.done():
        cell.cycle(1)
    with pytest.raises(
        CommandError, match=f"the axis {axis.name} is at {axis.in_words(0.05)}: move it to 0.0 {axis.unit}"
    ):
        scan.result.result()


def test_motion_beyond_the_limit_of_the_axis_is_refused(cell: SteppedCell) -> None:
    (axis,) = cell.session.nominal.further_axes
    cell.live.submit(MoveAxis(axis.name, axis.max + 0.01))
    state = cell.cycle(6)
    assert f"the axis {axis.name}" in state.refusal
    cell.live.submit(MoveAxis("nothing", 0.0))
    assert f"name = 'nothing': expected {axis.name}" in cell.cycle(4).message
    cell.live.submit(MoveJoints(cell.session.home))
    assert cell.until(lambda now: not now.refusal).further_axes == pytest.approx([0.0], abs=1e-5)


def test_workspace_starts_with_the_sensor_over_the_part(name: str, server: Any, tmp_path: Path) -> None:
    settings = {"track": "cell.axis[1].start_mm=80", "tilt_turn": "cell.axis[1].start_deg=5"}
    setup = load_setup(assets_dir() / f"cells/{name}.toml", settings=[settings[name]])
    with Scanner(setup=setup, threads=1) as scanner, scanner.session(PART, guarded=True) as session:
        opener: Any = SimpleNamespace()
        workspace = Workspace(server, session, PART.name, WorkspaceSettings(tmp_path, "geometric"), opener)
        over = pose.inverse(session.world_from_tool()) @ session.nominal.world_from("part", session.commanded)
        assert np.hypot(*over[:2, 3]) < 0.05
        for _ in range(3):
            workspace.live.step()
        workspace.show()
        for frame in ("base", "sensor", "table"):
            if frame in workspace.scene._bodies.names:
                expected = session.nominal.world_from(frame, session.commanded)[:3, 3]
                assert workspace.scene.position(frame) == pytest.approx(expected, abs=1e-4)
        workspace.feed.close()


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        ({"command": "move_axis", "value": 0.1}, "move_axis: axis"),
        ({"command": "move_axis", "value": 0.1, "axis": "Track"}, "move_axis: axis"),
        ({"command": "move_axis", "axis": "track"}, "move_axis: position"),
        ({"command": "move_axis", "value": 0.1, "axis": "track", "unit": "inch"}, "move_axis: axis"),
        ({"command": "wait", "value": 0.1, "axis": "track"}, "wait: axis"),
    ],
    ids=["no axis", "no name", "no position", "no unit", "of another command"],
)
def test_steps_of_no_axis_are_refused(step: dict[str, Any], expected: str) -> None:
    with pytest.raises(DescriptionError, match=expected):
        TaughtStep(**step)


@pytest.mark.parametrize(
    "command", ["robot.move_axis(100 * mm)", 'robot.move_axis("track")', "robot.move_axis(track, 1)"]
)
def test_text_that_moves_no_axis_is_refused(command: str) -> None:
    with pytest.raises(DescriptionError, match=r"taught\.py:2"):
        read_program(f"def main(robot):\n    {command}\n", "taught.py")


def test_number_without_a_unit_keeps_its_digits() -> None:
    text = program_text(TaughtProgram({}, (TaughtStep("move_axis", value=0.123456, axis="track"),)))
    assert 'robot.move_axis("track", 0.123456)' in text
    assert read_program(text, "taught.py").steps[0].value == 0.123456
