"""The live cell in browsers."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING

from scancell.config.choices import LOOPBACK
from scancell.config.sensor import SensorDescription
from scancell.extras import require
from scancell.scanning.session import ScanSession
from scancell.stopwatch import Pace
from scancell.workspace.browser.client_view import ClientView
from scancell.workspace.browser.desk import Desk
from scancell.workspace.browser.operators import Operators
from scancell.workspace.browser.scene import CellScene
from scancell.workspace.browser.status import Status
from scancell.workspace.live import LiveCell

if TYPE_CHECKING:
    import viser

_RATE = 30.0  # Hz, of the scene
_PANELS_EVERY = 3  # updates of the scene from one update of the panels to the next


class Workspace:
    """Shows a live cell on a server of viser, and hands over what its browsers command.

    Parameters
    ----------
    server
        Of viser.
    session
        A running cell that nothing else steps.
    sensor
        Nominal description.
    name
        Of the part, for the title.
    """

    def __init__(self, server: viser.ViserServer, session: ScanSession, sensor: SensorDescription, name: str) -> None:
        self.live = LiveCell(session)
        self._server, self._session = server, session
        self._scene = CellScene(server, session.true, sensor)
        self._operators, self._lock = Operators(), Lock()
        self._views: dict[int, ClientView] = {}
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.set_panel_label(f"scancell: {name}")
        self._status = Status(server.gui, self.live.stop)
        server.on_client_connect(self._join)
        server.on_client_disconnect(self._leave)

    def run(self, stop: Event) -> None:
        """Run the cell in real time, and show it, until `stop`.

        Raises
        ------
        CellError
            If the FMU reports an error.
        """
        errors: list[BaseException] = []

        def step() -> None:
            try:
                self.live.run(stop.is_set)
            except BaseException as error:  # it is raised in the thread that waits for this one
                errors.append(error)
                stop.set()

        stepping = Thread(target=step, name="cell")
        stepping.start()
        try:
            self._show_until(stop)
        finally:
            stop.set()
            stepping.join()
        if errors:
            raise errors[0]

    def _show_until(self, stop: Event) -> None:
        pace, updates = Pace(1 / _RATE), 0
        while not stop.is_set():
            self.show(with_panels=updates % _PANELS_EVERY == 0)
            updates += 1
            pace.wait()

    def show(self, with_panels: bool = True) -> None:
        """Show the present state, in the scene and in the panels."""
        state = self.live.state
        self._scene.show(state)
        if not with_panels:
            return
        self._status.show(state)
        with self._lock:
            views = list(self._views.values())
        for view in views:
            view.show(state)

    def _join(self, client: viser.ClientHandle) -> None:
        self._operators.join(client.client_id)
        desk = Desk(client, self._operators, self.live, self._session)
        view = ClientView(client, desk, self.live.state)
        with self._lock:
            self._views[client.client_id] = view

    def _leave(self, client: viser.ClientHandle) -> None:
        self._operators.leave(client.client_id)
        with self._lock:
            self._views.pop(client.client_id, None)


def serve_workspace(
    session: ScanSession,
    sensor: SensorDescription,
    name: str,
    *,
    host: str = LOOPBACK,
    port: int = 8080,
    started: Callable[[str], None] = lambda _: None,
    stop: Event | None = None,
) -> None:
    """Show a live cell in browsers until `stop` is set or Ctrl-C.

    Parameters
    ----------
    port
        To listen on; a taken one makes it take the next free one.
    started
        Receives the address to open.

    Raises
    ------
    ScancellError
        If viser is not installed, or the FMU reports an error.
    """
    stop = stop or Event()
    server = require("viser", "workspace").ViserServer(host=host, port=port, verbose=False)
    try:
        workspace = Workspace(server, session, sensor, name)
        started(f"http://{server.get_host()}:{server.get_port()}")
        workspace.run(stop)
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
