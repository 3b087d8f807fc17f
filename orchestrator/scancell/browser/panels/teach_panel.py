"""Teaching: steps of a robot program from the present pose of the robot."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from threading import RLock
from typing import Any

import numpy as np

from scancell.browser.panels.handles import pressed, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.cell.controller import Tool
from scancell.errors import CommandError, DescriptionError, ScancellError
from scancell.live.commands import CloseGripper, MoveJoints, MoveTool, OpenGripper
from scancell.live.state import LiveState
from scancell.nominal.tools import tool_names
from scancell.programs.robot import deg, mm
from scancell.programs.taught import WORDS, Command, JointPoint, Point, PosePoint, TaughtProgram, TaughtStep
from scancell.programs.taught_file import TaughtFile
from scancell.programs.taught_text import MAX_BYTES, read_program

_KINDS: dict[str, Command] = {
    "joints": "move_joints",
    "line": "move_line",
    "scan line": "scan_line",
    "table": "turn_table",
    "open gripper": "open_gripper",
    "close gripper": "close_gripper",
    "wait": "wait",
}
_NAMES = {command: kind for kind, command in _KINDS.items()}
_TYPED: dict[Command, tuple[float, float]] = {  # unit and first value of a number that is typed
    "scan_line": (mm, 0.5),
    "open_gripper": (mm, 60.0),
    "close_gripper": (1.0, 20.0),
    "wait": (1.0, 1.0),
}
_NONE = "-"


class TeachPanel:
    """Edits the taught program, which all browsers share."""

    def __init__(self, gui: Any, operator: OperatorCommands, taught: TaughtFile) -> None:
        self._operator, self._taught = operator, taught
        self._lock = RLock()  # `show` and the callbacks of inputs run in several threads
        self._offered: Command | None = None  # whose number `_number` is
        tools = tool_names(operator.nominal)
        kinds = [kind for kind in _KINDS if "gripper" in tools or "gripper" not in kind]
        self._list = gui.add_html("")
        self._step = gui.add_dropdown("step", (_NONE,))
        selected = gui.add_button_group("this step", ("Move to", "Up", "Down", "Copy", "Delete"))
        change = gui.add_button_group("change its", ("Pose", "Name", "Speed", "Number"), hint="to the inputs below")
        self._kind = gui.add_dropdown("kind", kinds)
        self._tool = gui.add_dropdown("tool", tools, visible=len(tools) > 1)
        self._name = gui.add_text("name", "", hint="empty: the next of p1, p2, ...")
        self._speed = gui.add_slider("step speed, %", 1, 100, 1, 30)
        self._number = gui.add_number("number", 0.0, step=0.1, visible=False)
        add = gui.add_button("Add after this step", hint="the present pose")
        upload = gui.add_upload_button("Open a taught program", mime_type=".py")
        download, new = gui.add_button("Download the program"), gui.add_button("Begin a new program")
        self._upload = upload
        acts: dict[str, Callable[[], object]] = {
            "Move to": self._move_to,
            "Up": lambda: self._move(-1),
            "Down": lambda: self._move(1),
            "Copy": lambda: self._edit(lambda program, at: program.with_copy(at), 1),
            "Delete": lambda: self._edit(lambda program, at: program.without(at), -1),
            "Pose": self._set_pose,
            "Name": lambda: self._edit(lambda program, at: program.renamed(program.step(at).point, self._name.value)),
            "Speed": lambda: self._edit(lambda program, at: program.with_speed(at, self._speed.value / 100)),
            "Number": self._set_number,
        }
        for group in (selected, change):
            group.on_click(operator.operator_callback(pressed(group, acts)))
        self._kind.on_update(operator.callback(self._show_number))
        add.on_click(operator.operator_callback(self._add))
        upload.on_upload(operator.operator_callback(self._open))
        download.on_click(operator.callback(lambda: operator.send_file("taught.py", taught.text.encode())))
        new.on_click(operator.operator_callback(self._begin_new))
        inputs = [self._step, self._kind, self._tool, self._name, self._speed, self._number]
        operator.add_inputs([*inputs, add, upload, new])
        self._show()
        self._select(len(self._step.options) - 1)

    def show(self, _state: LiveState) -> None:
        """Show the steps."""
        with self._lock:
            self._show()

    def _show(self) -> None:
        try:
            program, error = self._taught.program, ""
        except ScancellError as failed:
            program, error = TaughtProgram(), str(failed)
        labels = [step_label(number, step) for number, step in enumerate(program.steps, start=1)]
        options = tuple(labels) or (_NONE,)
        if self._step.options != options:
            at = self._at
            self._step.options = options
            self._select(at)
        lines = [f"<b>{escape(label)}</b>" if label == self._step.value else escape(label) for label in labels]
        note = escape(error or ("" if labels else "no steps: bring the robot to a pose, and add it"))
        box = f'<div style="max-height:14em;overflow:auto">{small_html([*lines, note])}</div>'
        set_changed(self._list, "content", box)

    # The selected step

    @property
    def _at(self) -> int:
        return list(self._step.options).index(self._step.value)

    def _select(self, index: int) -> None:
        options = self._step.options
        set_changed(self._step, "value", options[min(max(index, 0), len(options) - 1)])

    def _edit(self, change: Callable[[TaughtProgram, int], TaughtProgram], shift: int = 0) -> None:
        """Change the program, and select the step `shift` after the selected one."""
        with self._lock:
            at = self._at
            self._taught.edit(lambda program: change(program, at))
            self._show()
            self._select(at + shift)

    def _move(self, by: int) -> None:
        self._edit(lambda program, at: program.moved(at, by), by)

    def _move_to(self) -> None:
        program = self._taught.program
        step = program.step(self._at)
        point, value = program.points.get(step.point), step.value or 0.0
        match step.command, point:
            case _, JointPoint():
                self._operator.submit(MoveJoints(point.joints, step.value, step.speed))
            case _, PosePoint():
                self._operator.submit(MoveTool(point.world_from_tool, step.tool, step.speed))
            case "turn_table", _:
                self._operator.submit(MoveJoints(self._operator.state.joints, value, step.speed))
            case "open_gripper", _:
                self._operator.submit(OpenGripper(value))
            case "close_gripper", _:
                self._operator.submit(CloseGripper(value))
            case _:
                raise CommandError(f"{_NAMES[step.command]}: there is nothing to move to")

    def _set_pose(self) -> None:
        state = self._resting_state()

        def change(program: TaughtProgram, at: int) -> TaughtProgram:
            step = program.step(at)
            if WORDS[step.command].value == "table_angle":
                program = program.with_value(at, state.table_angle)
            elif not step.point:
                raise DescriptionError(f"{_NAMES[step.command]}: the step has no pose")
            return program.with_point(step.point, self._point(step, state)) if step.point else program

        self._edit(change)

    def _set_number(self) -> None:
        def change(program: TaughtProgram, at: int) -> TaughtProgram:
            unit = self._unit(program.step(at).command)
            return program.with_value(at, self._number.value * unit)

        self._edit(change)

    # New steps

    def _add(self) -> None:
        self._show_number()  # the callback of `_kind`, in a thread of its own, may be later than this one
        state, command = self._resting_state(), _KINDS[self._kind.value]
        words, angle = WORDS[command], state.table_angle
        value = angle if words.value == "table_angle" else None
        if command in _TYPED:
            value = self._number.value * self._unit(command)
        with self._lock:
            program = self._taught.program
            name = "" if words.point is None else self._name.value.strip() or program.free_name()
            tool: Tool = self._tool.value if command == "move_line" else "sensor"
            step = TaughtStep(command, name, value, self._speed.value / 100 if words.moves else 1.0, tool)
            point, index = self._point(step, state) if name else None, self._at + 1 if program.steps else 0
            if isinstance(point, PosePoint):
                changed = program.with_line(index, step, point, angle)
            else:
                changed = program.with_step(index, step, point)
            self._taught.write(changed)
            self._show()
            self._select(index + len(changed.steps) - len(program.steps) - 1)
            self._name.value = ""

    def _point(self, step: TaughtStep, state: LiveState) -> Point:
        if step.command == "move_joints":
            return JointPoint(tuple(state.joints.tolist()))
        return PosePoint.of(np.asarray(self._operator.world_from_tool(step.tool, state.joints)))

    def _resting_state(self) -> LiveState:
        state = self._operator.state
        if state.moving:
            raise CommandError("the robot moves: wait until it is at rest")
        return state

    def _show_number(self) -> None:
        """Offer the number of the kind that is chosen."""
        with self._lock:
            command = _KINDS[self._kind.value]
            if command == self._offered:
                return
            self._offered = command
            self._number.visible = command in _TYPED
            if command in _TYPED:
                words = WORDS[command]
                self._number.value, self._number.label = _TYPED[command][1], f"{words.value}, {words.unit}"

    def _unit(self, command: Command) -> float:
        if command not in _TYPED:
            raise DescriptionError(f"{_NAMES[command]}: the step has no number that is typed")
        return _TYPED[command][0]

    # Files

    def _open(self) -> None:
        content = self._upload.value.content
        if len(content) > MAX_BYTES:
            raise DescriptionError(f"the file has {len(content)} bytes", expected=f"at most {MAX_BYTES}")
        try:
            text = content.decode()
        except UnicodeDecodeError as error:
            raise DescriptionError(f"the file is no text: {error.reason}", expected="a taught program") from None
        program = read_program(text, "the opened file")
        self._begin_new()
        self._taught.write(program)

    def _begin_new(self) -> None:
        kept = self._taught.set_aside()
        if kept is not None:
            self._operator.show_message(f"the program before: {kept}")


def _turned(angle: float) -> str:
    """An angle of the table, rad, as the slider states it, and its whole turns."""
    degrees = round(angle / deg, 1) + 0.0
    turns = int(degrees / 360.0) if abs(degrees) > 360.0 else 0
    rest = f"{round(degrees - 360.0 * turns, 1) + 0.0}°"
    if not turns:
        return rest
    return f"{rest} {'+' if turns > 0 else '-'} {abs(turns)} turn{'s' if abs(turns) > 1 else ''}"


def step_label(number: int, step: TaughtStep) -> str:
    """One line of the list."""
    words, parts = WORDS[step.command], [] if step.command == "turn_table" else [_NAMES[step.command]]
    if step.value is not None and words.value != "table_angle":
        parts.append(f"{step.value / _TYPED[step.command][0]:g} {words.unit}")
    elif step.value is not None:
        parts.append(f"table at {_turned(step.value)}")
    if step.tool != "sensor":
        parts.append(step.tool)
    if words.moves:
        parts.append(f"{100 * step.speed:g} %")
    return f"{number} {step.point}{': ' if step.point else ''}{', '.join(parts)}"
