"""Programs in the workspace: teaching, running, files and recordings."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from pathlib import Path, PurePath
from threading import Event, RLock, Thread
from typing import Any, Protocol

import numpy as np

from scancell.browser.panels.handles import WARNING, Follower, run_once, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.panels.scans import Scans
from scancell.cell.driver import Tool
from scancell.errors import CommandError, DescriptionError, OutputError, ScancellError
from scancell.files import first_free, read_file
from scancell.live.camera import CameraFeed
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk
from scancell.live.state import Cancel, CloseGripper, LiveState, MoveAxis, MoveJoints, MoveTool, OpenGripper
from scancell.nominal.cell import Axis, NominalCell, tool_names
from scancell.nominal.parts import PART_FORMATS
from scancell.programs.program import LiveProgram, LiveProgramState
from scancell.programs.robot import deg
from scancell.programs.taught import (
    COMMANDS,
    MAX_BYTES,
    CommandName,
    JointPoint,
    Point,
    PosePoint,
    TaughtFile,
    TaughtProgram,
    TaughtStep,
    read_program,
)
from scancell.progress import Pace
from scancell.values import Closing
from scancell.views.mcap_export import SessionRecorder

_KINDS = {arguments.label: command for command, arguments in COMMANDS.items()}
_NONE = "-"

_TAUGHT = "the taught program"
_SHOWN = 400  # lines of a program, around the marked one
_TO_MARK = """const box = this.parentElement, row = box.querySelector("[data-marked]");
if (row) box.scrollTop = row.offsetTop - box.offsetTop - box.clientHeight / 2;"""
_BOX = "font-family:monospace;white-space:pre;overflow:auto;font-size:0.75em;line-height:1.35;margin:0.3em 0.75em"
_MARKS = {"failed": "rgba(208,48,48,0.35)", "stopped": "rgba(224,138,0,0.35)"}
_ACTIVE_MARK = "rgba(47,125,50,0.35)"

_RATE = 30.0  # Hz, of states

_UNITS = ("mm", "m", "inch")
_LONGEST_NAME = 200  # bytes


class TeachPanel:
    """Edits the taught program, which all browsers share."""

    def __init__(self, gui: Any, operator: OperatorCommands, taught: TaughtFile) -> None:
        self._operator, self._taught = operator, taught
        self._lock = RLock()  # `show` and the callbacks of inputs run in several threads
        self._offered: CommandName | None = None  # whose number `_number` is
        tools = tool_names(operator.nominal)
        further = operator.nominal.further_axes
        self._kinds: dict[str, tuple[CommandName, str]] = {}  # command, and name of the axis that it moves
        lacking = {"scan_line": "sensor" not in tools, "turn_table": not operator.nominal.table_turns}
        for kind, command in _KINDS.items():
            if COMMANDS[command].of_axis:
                self._kinds |= {axis.name: (command, axis.name) for axis in further}
            elif not lacking.get(command, "gripper" in kind and "gripper" not in tools):
                self._kinds[kind] = command, ""
        self._list = gui.add_html("")
        self._step = gui.add_dropdown("step", (_NONE,))
        selected = {
            "Move to": self._move_to,
            "Up": lambda: self._move(-1),
            "Down": lambda: self._move(1),
            "Copy": lambda: self._edit(lambda program, at: program.with_copy(at), 1),
            "Delete": lambda: self._edit(lambda program, at: program.without(at), -1),
        }
        operator.connect_group(gui.add_button_group("this step", tuple(selected)), selected)
        changes = {
            "Pose": self._set_pose,
            "Name": lambda: self._edit(lambda program, at: program.renamed(program.step(at).point, self._name.value)),
            "Speed": lambda: self._edit(lambda program, at: program.with_speed(at, self._speed.value / 100)),
            "Number": self._set_number,
        }
        group = gui.add_button_group("change its", tuple(changes), hint="to the inputs below")
        operator.connect_group(group, changes)
        self._kind = operator.connect(gui.add_dropdown("kind", tuple(self._kinds)), self._show_number)
        self._tool = gui.add_dropdown("tool", tools, visible=len(tools) > 1)
        self._name = gui.add_text("name", "", hint="empty: the next of p1, p2, ...")
        self._speed = gui.add_slider("step speed, %", 1, 100, 1, 30)
        self._number = gui.add_number("number", 0.0, step=0.1, visible=False)
        operator.add_inputs([self._step, self._tool, self._name, self._speed, self._number])
        operator.connect(gui.add_button("Add after this step", hint="the present pose"), self._add)
        upload = gui.add_upload_button("Open a taught program", mime_type=".py")
        self._upload = operator.connect(upload, self._open)
        download = gui.add_button("Download the program")
        download.on_click(operator.callback(lambda: operator.send_file("taught.py", taught.text.encode())))
        operator.connect(gui.add_button("Begin a new program"), self._begin_new)
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
            case "move_axis", _:
                self._operator.submit(MoveAxis(step.axis, value, step.speed))
            case "turn_table", _:
                self._operator.submit(MoveJoints(self._operator.state.joints, value, step.speed))
            case "open_gripper", _:
                self._operator.submit(OpenGripper(value))
            case "close_gripper", _:
                self._operator.submit(CloseGripper(value))
            case _:
                raise CommandError(f"{COMMANDS[step.command].label}: there is nothing to move to")

    def _set_pose(self) -> None:
        state = self._resting_state()

        def change(program: TaughtProgram, at: int) -> TaughtProgram:
            step = program.step(at)
            if COMMANDS[step.command].value == "table_angle":
                program = program.with_value(at, state.table_angle)
            elif step.axis:
                program = program.with_value(at, self._position(step.axis, state))
            elif not step.point:
                raise DescriptionError(f"{COMMANDS[step.command].label}: the step has no pose")
            return program.with_point(step.point, self._point(step, state)) if step.point else program

        self._edit(change)

    def _set_number(self) -> None:
        def change(program: TaughtProgram, at: int) -> TaughtProgram:
            arguments = COMMANDS[program.step(at).command]
            if arguments.first_value is None:
                raise DescriptionError(f"{arguments.label}: the step has no number that is typed")
            return program.with_value(at, self._number.value * arguments.si_per_unit)

        self._edit(change)

    # New steps

    def _add(self) -> None:
        self._show_number()  # the callback of `_kind`, in a thread of its own, may be later than this one
        state, (command, axis) = self._resting_state(), self._kinds[self._kind.value]
        arguments, angle = COMMANDS[command], state.table_angle
        value = angle if arguments.value == "table_angle" else None
        speed = self._speed.value / 100 if arguments.moves else 1.0
        moves = [self._move_of(one, state, speed) for one in self._operator.nominal.further_axes]
        if arguments.first_value is not None:
            value = self._number.value * arguments.si_per_unit
        with self._lock:
            program = self._taught.program
            name = "" if arguments.point is None else self._name.value.strip() or program.free_name()
            tool: Tool = self._tool.value if command == "move_line" else "sensor"
            at = self._at + 1 if program.steps else 0
            if arguments.of_axis:
                changed = program.with_step(at, next(move for move in moves if move.axis == axis))
            else:
                step = TaughtStep(command, name, value, speed, tool)
                point = self._point(step, state) if name else None
                placed = program if point is None else program.with_axes(at, moves)
                index = at + len(placed.steps) - len(program.steps)
                if isinstance(point, PosePoint):
                    changed = placed.with_line(index, step, point, angle)
                else:
                    changed = placed.with_step(index, step, point)
            self._taught.write(changed)
            self._show()
            self._select(at + len(changed.steps) - len(program.steps) - 1)
            self._name.value = ""

    def _move_of(self, axis: Axis, state: LiveState, speed: float) -> TaughtStep:
        """The move of an axis to where it is."""
        return TaughtStep("move_axis", "", self._position(axis.name, state), speed, axis=axis.name, unit=axis.unit)

    def _position(self, axis: str, state: LiveState) -> float:
        """Measured position of an axis, rad or m."""
        names = [one.name for one in self._operator.nominal.further_axes]
        if axis not in names:
            raise DescriptionError(key="axis", value=axis, expected=", ".join(names) or "an axis: the cell has none")
        return float(state.further_axes[names.index(axis)])

    def _point(self, step: TaughtStep, state: LiveState) -> Point:
        if step.command == "move_joints":
            return JointPoint(tuple(state.joints.tolist()))
        return PosePoint.of(np.asarray(self._operator.world_from_tool(step.tool, state.axes)))

    def _resting_state(self) -> LiveState:
        state = self._operator.state
        if state.moving:
            raise CommandError("the robot moves: wait until it is at rest")
        return state

    def _show_number(self) -> None:
        """Offer the number of the kind that is chosen."""
        with self._lock:
            command, _ = self._kinds[self._kind.value]
            if command == self._offered:
                return
            self._offered = command
            arguments = COMMANDS[command]
            self._number.visible = arguments.first_value is not None
            if arguments.first_value is not None:
                self._number.value = arguments.first_value
                self._number.label = f"{arguments.value}, {arguments.unit}"

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


def step_label(number: int, step: TaughtStep) -> str:
    """One line of the list."""
    arguments = COMMANDS[step.command]
    parts = [] if step.command == "turn_table" or step.axis else [arguments.label]
    if step.value is not None and step.axis:
        parts.append(f"{step.axis} at {step.value_text.replace(' *', '')}")
    elif step.value is not None and arguments.value != "table_angle":
        parts.append(f"{step.value / arguments.si_per_unit:g} {arguments.unit}")
    elif step.value is not None:
        parts.append(f"table at {round(step.value / deg, 1) + 0.0}°")
    if step.tool != "sensor":
        parts.append(step.tool)
    if arguments.moves:
        parts.append(f"{100 * step.speed:g} %")
    return f"{number} {step.point}{': ' if step.point else ''}{', '.join(parts)}"


class ProgramPanel:
    """Runs the program of ``--program`` or the taught one, and shows its source, active line and output."""

    def __init__(
        self, gui: Any, operator: OperatorCommands, program: LiveProgram, taught: TaughtFile, file: Path | None
    ) -> None:
        self._program, self._taught = program, taught
        self._files = {} if file is None else {file.name: file}
        self._choice = gui.add_dropdown("program", (*self._files, _TAUGHT))
        operator.add_inputs([self._choice])
        operator.connect(gui.add_button("Run the program", hint="or continue it after a pause"), self._run)
        acts = {"Pause": program.pause, "Step": self._step, "End": lambda: operator.submit(Cancel())}
        more = gui.add_button_group("while it runs", tuple(acts), hint="Step: one command, also the first")
        operator.connect_group(more, acts)
        self._source, self._text = gui.add_html(""), gui.add_html("")

    def show(self, state: LiveState) -> None:
        """Show the program and its run."""
        run = self._program.state
        file = self._files.get(self._choice.value, self._taught.path)
        if run is not None and run.is_active:
            set_changed(self._source, "content", source_html(run.source, run))
        else:
            source = self._lines(file)
            is_same = run is not None and run.file == file and run.source == source
            set_changed(self._source, "content", source_html(source, run if is_same else None))
        set_changed(self._text, "content", "" if run is None else run_html(run))

    def _lines(self, file: Path) -> tuple[str, ...]:
        if file == self._taught.path:
            return tuple(self._taught.text.splitlines())
        try:
            return tuple(read_file(file).decode("utf-8", errors="replace").splitlines())
        except DescriptionError as error:
            return (str(error),)

    def _file(self) -> Path:
        """The chosen file; the taught one only while it is a list of steps."""
        file = self._files.get(self._choice.value)
        if file is None:
            file, _ = self._taught.path, self._taught.program
        return file

    def _run(self) -> None:
        run = self._program.state
        if run is not None and run.is_active:
            self._program.resume()
        else:
            self._program.start(self._file())

    def _step(self) -> None:
        self._program.step(self._file())


def source_html(lines: tuple[str, ...], run: LiveProgramState | None) -> str:
    """Numbered lines of a program; the active line of its run, or that of its end, is marked."""
    marked = 0 if run is None else run.line
    first = max(0, min(marked - _SHOWN // 2, len(lines) - _SHOWN))
    colour = _ACTIVE_MARK if run is None else _MARKS.get(run.stage, _ACTIVE_MARK)
    rows = []
    for number, line in enumerate(lines[first : first + _SHOWN], start=first + 1):
        mark = f' data-marked style="background:{colour}"' if number == marked else ""
        rows.append(f"<div{mark}>{number:4} {escape(line)}</div>")
    return f'<div style="{_BOX};max-height:16em">{"".join(rows)}{run_once(_TO_MARK)}</div>'


def run_html(run: LiveProgramState) -> str:
    """Stage, error, run folder and output of a run; the last line of output first."""
    where = f", line {run.line}" if run.line else ""
    head = [f"<b>{escape(run.file.name)}: {run.stage}{where}</b>", escape(run.error)]
    if run.folder is not None:
        head.append(f"recorded: {escape(str(run.folder))}")
    rows = "".join(f"<div>{escape(line)}</div>" for line in reversed(run.output))
    return f'{small_html(head)}<div style="{_BOX};max-height:10em">{rows}</div>'


class SessionRecording(Closing):
    """Writes states, camera frames and points of scans in a thread of its own. All methods are thread-safe.

    Parameters
    ----------
    live, cell, feed
        The running cell, its bodies, and its cameras.
    out
        Folder of the files ``session_1.mcap``, ``session_2.mcap``, ...
    """

    def __init__(self, live: LiveCell, cell: NominalCell, feed: CameraFeed, out: Path) -> None:
        self._live, self._cell, self._feed, self._out = live, cell, feed, out
        self._lock, self._ending = RLock(), Event()
        self._recorder: SessionRecorder | None = None
        self._thread: Thread | None = None
        self._path: Path | None = None
        self._error = ""

    @property
    def is_on(self) -> bool:
        """Whether recording is active."""
        return self._recorder is not None

    @property
    def path(self) -> Path | None:
        """The last file; None before the first."""
        return self._path

    @property
    def error(self) -> str:
        """Reason why the last recording ended early; empty if it did not."""
        return self._error

    def start(self) -> None:
        """Begin a file, unless recording is active.

        Raises
        ------
        ScancellError
            If the file cannot be written, or packages of the extra `workspace` are missing.
        """
        with self._lock:
            if self.is_on:
                return
            path = first_free(self._out, "session_{}.mcap")
            try:
                self._out.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
            self._recorder = SessionRecorder(path, self._cell)
            self._path, self._error = path, ""
            self._ending.clear()
            self._thread = Thread(target=self._record, name="record", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Complete the file, if recording is active."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()

    def points(self, chunk: LiveChunk) -> None:
        """Record points of a scan, if recording is active."""
        with self._lock:
            if self._recorder is not None:
                self._recorder.points(chunk)

    def close(self) -> None:
        """Stop recording, see `stop`."""
        self.stop()

    def _record(self) -> None:
        pace, number = Pace(1 / _RATE), 0
        try:
            while not self._ending.is_set() and self._recorder is not None:
                self._recorder.state(self._live.state)
                frame = self._feed.frame
                if frame is not None and frame.number != number and not frame.is_replayed:
                    number = frame.number
                    self._recorder.cameras(frame)
                pace.wait()
        except OutputError as error:
            self._error = str(error)
        finally:
            with self._lock:
                recorder, self._recorder = self._recorder, None
                if recorder is not None:
                    self._complete(recorder)

    def _complete(self, recorder: SessionRecorder) -> None:
        try:
            recorder.close()
        except OutputError as error:
            self._error = self._error or str(error)


class Opener(Protocol):
    """Opens another view."""

    def start_again(self) -> None:
        """Open the cell anew, with the same part."""

    def open_part(self, name: str, content: bytes, unit: str) -> None:
        """Show the cell with the file of a part, by its name, content and unit."""

    def open_run(self, name: str, content: bytes) -> None:
        """Play back a run, by the name and content of a zip file of its folder."""


class FilePanel:
    """Opens another part or a run, records the session, and saves pictures."""

    def __init__(
        self, gui: Any, operator: OperatorCommands, opener: Opener, recording: SessionRecording, scans: Scans
    ) -> None:
        self._opener, self._recording, self._scans = opener, recording, scans
        self._lost = gui.add_html("")
        self._unit = gui.add_dropdown("unit of the mesh", _UNITS)
        operator.add_inputs([self._unit])
        part = gui.add_upload_button(
            "Open a part (STL, OBJ, PLY, STEP, IGES, BREP, TOML)", mime_type=",".join(PART_FORMATS)
        )
        self._upload = operator.connect(part, self._open)
        run = gui.add_upload_button("Open a run (zip of a run folder)", mime_type=".zip,application/zip")
        operator.connect(run, lambda: opener.open_run(_checked_name(run.value), run.value.content))
        self._record = Follower(gui.add_checkbox("Record (MCAP)", recording.is_on))
        operator.connect(self._record.handle, self._switch_recording)
        self._text = gui.add_html("")
        picture = gui.add_button("Download a picture")
        picture.on_click(operator.callback(lambda: operator.send_file("scancell.png", operator.picture())))

    def show(self, state: LiveState) -> None:
        """Show the state and the file of the recording, and what another part or run discards."""
        lost = self._scans.unsaved and f"Another part or run discards {self._scans.unsaved}."
        set_changed(self._lost, "content", small_html([f'<b style="color:{WARNING}">{lost}</b>' if lost else ""]))
        recording = self._recording
        self._record.show(recording.is_on)
        text = recording.error
        if not text and recording.path is not None:
            text = f"{'recording' if recording.is_on else 'recorded'}: {recording.path}"
        set_changed(self._text, "content", small_html([escape(text)]))

    def _switch_recording(self) -> None:
        if self._recording.is_on:
            self._recording.stop()
            return
        try:
            self._recording.start()
        finally:
            set_changed(self._record.handle, "value", self._recording.is_on)

    def _open(self) -> None:
        file = self._upload.value
        name = _checked_name(file)
        if Path(name).suffix.lower() not in PART_FORMATS:
            raise DescriptionError(f"{name}: expected the file of a part, {', '.join(PART_FORMATS)}")
        self._opener.open_part(name, file.content, self._unit.value)


def _checked_name(file: Any) -> str:
    name = PurePath(file.name).name
    if not name.isprintable() or not 0 < len(name.encode()) <= _LONGEST_NAME:
        shown = ascii(name if len(name) <= 60 else f"{name[:40]}...{name[-10:]}")
        raise DescriptionError(f"{shown}: expected a file name of at most {_LONGEST_NAME} printable characters")
    return name
