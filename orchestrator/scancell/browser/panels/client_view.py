"""The panels of one browser."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from scancell.browser.panels.cell_panel import CellPanel
from scancell.browser.panels.file_panel import FilePanel, Opener
from scancell.browser.panels.handles import set_changed
from scancell.browser.panels.jog_panel import JogPanel
from scancell.browser.panels.joint_panel import JointPanel
from scancell.browser.panels.messages import report_errors
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.panels.plan_panel import PlanPanel
from scancell.browser.panels.plans import Plans
from scancell.browser.panels.pose_panel import PosePanel
from scancell.browser.panels.program_panel import ProgramPanel
from scancell.browser.panels.recording import SessionRecording
from scancell.browser.panels.scan_panel import ScanPanel
from scancell.browser.panels.scans import Scans
from scancell.browser.panels.sensor_panel import SensorPanel
from scancell.browser.panels.teach_panel import TeachPanel
from scancell.config.sensor import SensorDescription
from scancell.live.camera import CameraFeed
from scancell.live.commands import Reset
from scancell.live.state import LiveState
from scancell.programs.live_program import LiveProgram
from scancell.programs.taught_file import TaughtFile

if TYPE_CHECKING:
    import viser


class Panel(Protocol):
    """Part of the view of a browser."""

    def show(self, state: LiveState) -> None:
        """Show a state; called ten times a second from one thread."""


@dataclass(frozen=True)
class Shared:
    """Objects that all browsers share; `program_file` is None if the workspace was started without one."""

    plans: Plans
    scans: Scans
    feed: CameraFeed
    recording: SessionRecording
    sensor: SensorDescription
    program: LiveProgram
    taught: TaughtFile
    program_file: Path | None
    opener: Opener


class ClientView:
    """Shows the cell's state in one browser, whose inputs work while it is the operator.

    It keeps no state that a reload of the page would lose.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        operator: OperatorCommands,
        shared: Shared,
        state: LiveState,
    ) -> None:
        gui, self._operator = client.gui, operator
        self._take = gui.add_button("Take control", hint="another browser controls the cell", visible=False, order=-5)
        self._take.on_click(operator.callback(operator.take_control))
        self._reset = gui.add_button(
            "Reset after a stop", hint="release the stop; nothing moves", visible=False, order=-6
        )
        self._reset.on_click(operator.callback(lambda: operator.submit(Reset())))
        operator.add_inputs([self._reset])
        tabs = gui.add_tab_group(order=0)
        self._panels: list[Panel] = []
        with tabs.add_tab("Joints"):
            self._panels.append(JointPanel(gui, operator, state))
        with tabs.add_tab("Pose"):
            self._panels.append(PosePanel(gui, client.scene, operator, state))
        with tabs.add_tab("Jog"):
            self._panels.append(JogPanel(gui, operator, state))
        with tabs.add_tab("Cell"):
            self._panels.append(CellPanel(gui, operator, state))
        with tabs.add_tab("Sensor"):
            self._panels.append(SensorPanel(gui, operator, shared.feed, shared.sensor))
        with tabs.add_tab("Plan"):
            self._panels.append(PlanPanel(gui, operator, shared.plans))
        with tabs.add_tab("Scan"):
            self._panels.append(ScanPanel(gui, operator, shared.scans))
        with tabs.add_tab("Program"):
            programs = gui.add_tab_group()
        with programs.add_tab("Run"):
            self._panels.append(ProgramPanel(gui, operator, shared.program, shared.taught, shared.program_file))
        with programs.add_tab("Teach"):
            self._panels.append(TeachPanel(gui, operator, shared.taught))
        with tabs.add_tab("File"):
            self._panels.append(FilePanel(gui, operator, shared.opener, shared.recording))
        self._said: dict[Panel, str] = {}
        self.show(state)

    def show(self, state: LiveState) -> None:
        """Show a state."""
        set_changed(self._take, "visible", not self._operator.is_operator)
        set_changed(self._reset, "visible", state.controller == "emergency stop")
        self._operator.enable_inputs()
        for panel in self._panels:
            failures: list[str] = []
            report_errors(partial(panel.show, state), failures.append)
            text = "".join(failures)
            if text and text != self._said.get(panel):  # it may fail in every update
                self._operator.show_message(text)
            self._said[panel] = text
