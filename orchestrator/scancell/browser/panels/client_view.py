"""The panels of one browser."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from scancell.browser.panels.camera_panel import CameraPanel, ViewPanel
from scancell.browser.panels.cell_panel import CellPanel, JogPanel, JointPanel, PosePanel, SensorPanel
from scancell.browser.panels.handles import report_errors, set_changed
from scancell.browser.panels.help import ExercisePanel, TourCard, add_help
from scancell.browser.panels.operator_commands import OperatorCommands, is_stopped
from scancell.browser.panels.plans import PlanPanel, Plans
from scancell.browser.panels.scans import ScanPanel, ScanPlayback, Scans
from scancell.browser.panels.teach_panel import FilePanel, Opener, ProgramPanel, SessionRecording, TeachPanel
from scancell.browser.scene.scene import CellScene
from scancell.config.sensor import SensorDescription
from scancell.exercises import Attempt
from scancell.live.camera import CameraFeed
from scancell.live.state import LiveState, Reset
from scancell.programs.program import LiveProgram
from scancell.programs.taught import TaughtFile

if TYPE_CHECKING:
    import viser


class Panel(Protocol):
    """Part of the view of a browser."""

    def show(self, state: LiveState) -> None:
        """Show a state; called ten times a second from one thread."""


@dataclass(frozen=True)
class Shared:
    """Objects that all browsers share; `program_file` and `attempt` are None if the workspace was started without.

    `next_step` returns the next step of the tour.
    """

    scene: CellScene
    plans: Plans
    scans: Scans
    playback: ScanPlayback
    feed: CameraFeed
    recording: SessionRecording
    sensors: Mapping[str, SensorDescription]
    program: LiveProgram
    taught: TaughtFile
    program_file: Path | None
    opener: Opener
    attempt: Attempt | None
    next_step: Callable[[], str]
    out: Path


class ClientView:
    """Shows the cell's state in one browser, whose inputs work while it is the operator.

    Apart from its viewpoint it keeps no state that a reload of the page would lose.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        operator: OperatorCommands,
        shared: Shared,
        state: LiveState,
        is_wide: bool,
    ) -> None:
        self._gui, self._operator = client.gui, operator
        gui = client.gui
        self._take = gui.add_button("Take control", hint="another browser controls the cell", visible=False, order=-5)
        self._take.on_click(operator.callback(operator.take_control))
        reset = gui.add_button("Reset after a stop", hint="release the stop; nothing moves", order=-6)
        operator.connect(reset, lambda: operator.submit(Reset()), is_stopped)
        tabs = gui.add_tab_group(order=0)
        self._panels: list[Panel] = []
        if (attempt := shared.attempt) is not None:
            again = shared.opener.start_again
            self._add_tab(tabs, "Exercise", lambda: ExercisePanel(gui, operator, attempt, again, shared.out))
        with tabs.add_tab("Move"):
            motions = gui.add_tab_group()
        self._add_tab(motions, "Joints", lambda: JointPanel(gui, operator, state))
        self._add_tab(motions, "Pose", lambda: PosePanel(gui, client.scene, operator, state))
        self._add_tab(motions, "Jog", lambda: JogPanel(gui, operator, state))
        self._add_tab(motions, "Cell", lambda: CellPanel(gui, operator, state))
        self._add_tab(
            tabs, "Sensor", lambda: SensorPanel(gui, operator, shared.feed, next(iter(shared.sensors.values())))
        )
        scan = self._add_tab(tabs, "Scan", lambda: ScanPanel(gui, operator, shared.scans, shared.playback))
        with scan, gui.add_folder("Plan", expand_by_default=False):
            self._panels.append(PlanPanel(gui, operator, shared.plans))
        with tabs.add_tab("Program"):
            programs = gui.add_tab_group()
        self._add_tab(
            programs, "Run", lambda: ProgramPanel(gui, operator, shared.program, shared.taught, shared.program_file)
        )
        self._add_tab(programs, "Teach", lambda: TeachPanel(gui, operator, shared.taught))
        self._add_tab(tabs, "File", lambda: FilePanel(gui, operator, shared.opener, shared.recording, shared.scans))
        self._cameras = CameraPanel(gui, shared.feed, shared.sensors, is_wide)
        self._view = ViewPanel(gui, client.camera, operator, shared.scene)
        self._next_step = shared.next_step
        self._card = TourCard(gui) if shared.attempt is None else None
        self._said: dict[object, str] = {}
        self.show(state)

    def show_pictures(self) -> None:
        """Show a new camera frame, and follow the sensor; called as often as the scene is updated."""
        self._report(self._cameras, self._cameras.show)
        self._report(self._view, self._view.update)

    def show(self, state: LiveState) -> None:
        """Show a state."""
        set_changed(self._take, "visible", not self._operator.is_operator)
        self._operator.enable_inputs(state)
        if self._card is not None:
            self._card.show(self._next_step())
        # Less often than the small images: it takes longer.
        self._report(self._cameras, self._cameras.show_enlarged)
        for panel in self._panels:
            self._report(panel, partial(panel.show, state))

    def _add_tab(self, group: Any, name: str, make: Callable[[], Panel]) -> Any:
        tab = group.add_tab(name)
        with tab:
            self._panels.append(make())
            add_help(self._gui, name)
        return tab

    def _report(self, panel: object, show: Callable[[], None]) -> None:
        """Show the error of a panel, once, as it may fail in every update."""
        failures: list[str] = []
        report_errors(show, failures.append)
        text = "".join(failures)
        if text and text != self._said.get(panel):
            self._operator.show_message(text)
        self._said[panel] = text
