"""A live cell in browsers, and the panels of each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event, Lock
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scancell.browser.panels.camera_panel import CameraPanel, ViewPanel, add_view_options
from scancell.browser.panels.cell_panel import CellPanel, JogPanel, JointPanel, PosePanel, SensorPanel
from scancell.browser.panels.faces import FacesPanel, PartFaces
from scancell.browser.panels.handles import report_errors, set_changed
from scancell.browser.panels.help import ExercisePanel, HelpPanel, TourCard, add_help
from scancell.browser.panels.operator_commands import OperatorCommands, is_stopped
from scancell.browser.panels.plans import PlanPanel, Plans
from scancell.browser.panels.scans import ScanPanel, ScanPlayback, Scans
from scancell.browser.panels.status import Status
from scancell.browser.panels.teach_panel import FilePanel, Opener, ProgramPanel, SessionRecording, TeachPanel
from scancell.browser.scene.scene import CellScene, LiveCloud
from scancell.browser.server.gate import Operators
from scancell.config.choices import Engine
from scancell.config.sensor import SensorDescription
from scancell.errors import CommandError, PlanningError
from scancell.exercises import Attempt, Exercise
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh
from scancell.live.camera import CameraFeed
from scancell.live.cell import LiveCell
from scancell.live.plan import LivePlan
from scancell.live.state import LiveState, Reset
from scancell.nominal.cell import NominalCell
from scancell.programs.program import LiveProgram
from scancell.programs.taught import TaughtFile
from scancell.progress import Pace
from scancell.scanning.session import ScanSession

if TYPE_CHECKING:
    import viser

_RATE = 40.0  # Hz, of the scene at most
_TURNS_DEG = (0.0, 90.0, 180.0, 270.0)  # of a part on the flange before the sensor, about the axis of the flange
_PANELS_EVERY = 4  # updates of the scene from one update of the panels to the next


@dataclass(frozen=True)
class WorkspaceSettings:
    """Settings of a workspace.

    Attributes
    ----------
    out
        Folder of saved files.
    engine
        Initial engine of scans and robot programs.
    program
        File of a robot program.
    exercise
        Exercise to do in the cell with its part.
    """

    out: Path = Path("out/workspace")
    engine: Engine = "ray-traced"
    program: Path | None = None
    exercise: Exercise | None = None


class Workspace:
    """Shows a live cell on a server of viser, and submits the commands of its browsers.

    Parameters
    ----------
    server
        Server of viser.
    session
        A running cell that nothing else steps.
    part
        File name of the part; None: the table is empty.
    opener
        Opens another view.

    Attributes
    ----------
    live
        The cell.
    nominal
        Its nominal geometry.
    scene
        Scene, shared by all browsers.
    plans
        The plan of the scan.
    faces
        Faces of the part; None where it is no CAD part.
    scans, playback
        Scans of the part, and the last one played back.
    feed
        Frames of the cameras.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        session: ScanSession,
        part: str | None,
        settings: WorkspaceSettings,
        opener: Opener,
    ) -> None:
        self.nominal, self._session = session.nominal, session
        over_part = _over_part(session.nominal, session.world.setup.sensor)
        if part is not None and settings.exercise is None and session.world.setup.cell.part.arrival is None:
            _start_over_part(session, over_part)
        self.live = LiveCell(session)
        setup, mesh = session.world.setup, session.nominal.part if part is not None else None
        self.scene = CellScene(server, session.true, setup.sensor, setup.cell)
        self.feed = CameraFeed(self.live, session, settings.engine)
        self._recording = SessionRecording(self.live, session.true, self.feed, settings.out)
        self.scans = Scans(
            self.live, LiveCloud(self.scene), mesh, settings.out, settings.engine, self._recording.points
        )
        self.playback = ScanPlayback(self.live, session.true, self.scans, self.feed, self.scene)
        has_part = mesh is not None
        self.faces = PartFaces(mesh, self.scene, lambda: self.scans.result) if isinstance(mesh, CadMesh) else None
        self.plans = Plans(LivePlan(self.live, session, has_part), self.scene, has_part)
        self._operators, self._lock = Operators(), Lock()
        self._views: dict[int, ClientView] = {}
        server.gui.set_panel_label(f"scancell: {part or 'empty table'}")
        server.gui.main_panel.dock_right()
        self._status = Status(server.gui, self.live.emergency_stop)
        add_view_options(server.gui, self.scene)
        self.feed.wanted, self._drawn = True, 0
        program = LiveProgram(self.live, settings.engine, settings.out, self.scans.points_of_program)
        taught = TaughtFile(settings.out / "taught.py")
        self._help = HelpPanel(server.gui, self.feed, self.scans, taught, program, self.live.state, over_part)
        exercise, attempt = settings.exercise, None
        if exercise is not None and session.world.part_file == exercise.part_file:
            attempt = Attempt(exercise, self.live, session, program, taught)
        self._shared = Shared(
            self.scene,
            self.plans,
            self.scans,
            self.playback,
            self.faces,
            self.feed,
            self._recording,
            {name: setup.seen_by(number).sensor for number, name in enumerate(setup.sensor_names, 1)},
            program,
            taught,
            settings.program,
            opener,
            attempt,
            lambda: self._help.next_step,
            settings.out,
        )

    def run(self, ended: Callable[[], bool]) -> None:
        """Run the cell in real time, and show it, until `ended`.

        Raises
        ------
        CellError
            If the FMU reports an error.
        """
        closing, owned = Event(), Lock()

        def step() -> None:
            with owned:
                if not closing.is_set():
                    self.live.run(closing.is_set)

        with self.feed, self._recording, ThreadPoolExecutor(1, "cell") as threads:
            try:
                stepping = threads.submit(step)
                pace, updates = Pace(1 / _RATE), 0
                while not (ended() or stepping.done()):
                    with _viser_wakes_its_loop():
                        self.show(with_panels=updates % _PANELS_EVERY == 0)
                    updates += 1
                    pace.wait()
            finally:
                closing.set()
                with owned:  # an interrupt inside submit leaves a thread that the executor does not wait for
                    pass
        stepping.result()

    def show(self, with_panels: bool = True) -> None:
        """Show the present state, in the scene and in the panels."""
        state = self.live.state
        self.plans.update()
        self.playback.update()
        if not self.playback.is_on:
            self.scene.show(state)
        self._show_stripe()
        with self._lock:
            views = list(self._views.values())
        for view in views:
            view.show_pictures()
        if with_panels:
            self._status.show(state, self.scans.state)
            self._help.show(state)
            for view in views:
                view.show(state)

    def _show_stripe(self) -> None:
        """Draw the stripe of the last frame in the scene, or none while no frames are wanted."""
        frame = self.feed.frame if self.feed.wanted else None
        number = 0 if frame is None else frame.number
        if number != self._drawn:
            self._drawn = number
            self.scene.show_stripe(None if frame is None else frame.points_in_world)

    def join(self, client: viser.ClientHandle, is_wide: bool) -> None:
        """Give a browser, whose window is wide or not, its panels; the first one becomes the operator."""
        self._operators.join(client.client_id)
        operator = OperatorCommands(client, self._operators, self.live, self._session)
        view = ClientView(client, operator, self._shared, self.live.state, is_wide)
        with self._lock:
            self._views[client.client_id] = view

    def leave(self, client: viser.ClientHandle) -> None:
        """Remove a browser."""
        self._operators.leave(client.client_id)
        with self._lock:
            self._views.pop(client.client_id, None)


def _above(cell: NominalCell, sensor: SensorDescription, frame_from_part: NDArray[np.float64]) -> NDArray[np.float64]:
    """Position (3,) in a frame from which a sensor that looks along -z has the part in the middle of its range, m."""
    corners = pose.transform_points(frame_from_part, cell.part.vertices)
    middle = (corners.min(0) + corners.max(0)) / 2
    standoff = 0.5e-3 * (sensor.range.near_mm + sensor.range.far_mm)
    return np.array([middle[0], middle[1], corners[:, 2].max() + standoff])


def _over_part(cell: NominalCell, sensor: SensorDescription) -> NDArray[np.float64] | None:
    """Position (3,) in the base from which a sensor that looks down has the part in the middle of its range, m.

    Axes beyond the table are where they start. None where the flange does not carry the sensor.
    """
    if not cell.carries_sensor:
        return None
    cell = cell.with_axes_held()
    above = _above(cell, sensor, cell.world_from("part"))
    return np.asarray(pose.transform_points(pose.inverse(cell.arm.world_from_base), above[None])[0])


def _start_over_part(session: ScanSession, over_part: NDArray[np.float64] | None) -> None:
    """Bring sensor and part together, so that the first frame has a stripe; the arm stays at home if it cannot.

    A sensor on the flange comes `over_part`; a part on the flange comes before the sensor, turned as it can be.
    """
    world, nominal, looks_down = session.world, session.nominal, np.diag([1.0, -1.0, -1.0])
    if over_part is not None:
        base = nominal.with_axes_held().arm.world_from_base
        tool, targets = "sensor", (base @ pose.from_rotation(looks_down, over_part))[None]
    elif nominal.holds_part:
        view = pose.from_rotation(looks_down, _above(nominal, world.setup.sensor, nominal.support_from_part))
        turns = pose.from_rotation(pose.rotation_about(2, np.radians(_TURNS_DEG)))
        tool, targets = "flange", nominal.world_from_flange(turns @ view, nominal.start, nominal.support)
    else:
        return
    start = session.come_to_rest()
    for target in targets:
        with suppress(CommandError, PlanningError):
            joints = session.joints_for(target, tool, start[: len(session.home)])
            goal = np.append(joints, start[len(session.home)])
            way = session.pipeline.approach(world, start, goal, "the part")
            if way is not None:
                session.run_program(way, session.exposure)
                return


@contextmanager
def _viser_wakes_its_loop() -> Iterator[None]:
    """Ignore a race of viser: it sets an asyncio event in our thread, after it has kept the message.

    The next message wakes its event loop again.
    """
    try:
        yield
    except RuntimeError as error:
        if "mutated during iteration" not in str(error):
            raise


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
    faces: PartFaces | None
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
        if (faces := shared.faces) is not None:
            with scan, gui.add_folder("Faces"):
                self._panels.append(FacesPanel(gui, operator, faces, shared.scans))
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
