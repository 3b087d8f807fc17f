"""Server of a live cell for browsers, which can also open other parts and recorded runs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Lock, RLock
from typing import TYPE_CHECKING, Protocol

from scancell.browser.panels.scans import Playback
from scancell.browser.server.gate import address, quiet_server
from scancell.browser.server.workspace import Workspace, WorkspaceSettings
from scancell.config.choices import LOOPBACK
from scancell.errors import CommandError, ScancellError
from scancell.scanning.session import ScanSession
from scancell.views.recorded_run import open_archive

if TYPE_CHECKING:
    import viser


_WIDE = 1.2  # width over height of a window with room for a panel on both sides


@dataclass(frozen=True)
class PartFile:
    """The file of a part, and the unit of a mesh."""

    path: Path
    unit: str = "mm"


OpenSession = Callable[[PartFile | None], AbstractContextManager[ScanSession]]


class View(Protocol):
    """A live cell, or a run that is played back, as a host shows it on an empty page."""

    def run(self, ended: Callable[[], bool]) -> None:
        """Run the view until `ended`."""

    def join(self, client: viser.ClientHandle, is_wide: bool) -> None:
        """Add a browser, whose window is wide or not."""

    def leave(self, client: viser.ClientHandle) -> None:
        """Remove a browser."""


@dataclass(frozen=True)
class _Opened:
    """Makes a view, and releases its resources."""

    make: Callable[[], View]
    resources: ExitStack


class Host:
    """Shows one view after another in the browsers of a server.

    Parameters
    ----------
    server
        Server of viser.
    open_session
        Starts the cell with a part, or an empty table.
    settings
        Settings of the workspace.
    """

    def __init__(self, server: viser.ViserServer, open_session: OpenSession, settings: WorkspaceSettings) -> None:
        self._server, self._open_session, self._settings = server, open_session, settings
        self._lock = RLock()
        self._view: View | None = None
        self._next: _Opened | None = None
        self._part: PartFile | None = None
        self._parts = tempfile.TemporaryDirectory(prefix="scancell-parts-")
        self._opening = Lock()
        self._is_wide: dict[int, bool] = {}  # window, by the number of the browser
        server.on_client_connect(self._join)
        server.on_client_disconnect(self._leave)

    @property
    def view(self) -> View | None:
        """The present view."""
        return self._view

    @property
    def workspace(self) -> Workspace | None:
        """The live cell; None while a run is played back."""
        return self._view if isinstance(self._view, Workspace) else None

    def run(self, part: PartFile | None, stop: Event, started: Callable[[], None] = lambda: None) -> None:
        """Show the cell with a part, then each view that is opened, until `stop`.

        Parameters
        ----------
        started
            Called when browsers can see the cell.

        Raises
        ------
        ScancellError
            If the part cannot be loaded, or the FMU reports an error.
        """
        with self._parts:
            opened: _Opened | None = self._open_cell(part)
            while opened is not None:
                with opened.resources:
                    view = self._show(opened)
                    started()
                    started = _nothing
                    view.run(lambda: stop.is_set() or self._next is not None)
                with self._lock:
                    opened, self._next = self._next, None
                if stop.is_set() and opened is not None:
                    opened.resources.close()
                    return

    def open_part(self, name: str, content: bytes, unit: str) -> None:
        """Load a mesh, and show the cell with it instead of the present part.

        Raises
        ------
        ScancellError
            If it cannot be loaded or does not fit the cell; the present part stays then.
        """
        with self._one_file():
            path = Path(self._parts.name) / name
            path.write_bytes(content)
            try:
                self._show_next(self._open_cell(PartFile(path, unit)))
            except ScancellError as error:  # the temporary folder means nothing to the user
                raise type(error)(str(error).replace(f"{self._parts.name}/", "")) from None

    def open_run(self, name: str, content: bytes) -> None:
        """Play back a run instead; the cell is closed.

        Raises
        ------
        ScancellError
            See `open_archive`; the cell stays then.
        """
        with self._one_file():
            run = open_archive(content, name)
            self._show_next(
                _Opened(lambda: Playback(self._server, run, "deviation", back=self.start_again), ExitStack())
            )

    @contextmanager
    def _one_file(self) -> Iterator[None]:
        if not self._opening.acquire(blocking=False):
            raise CommandError("a file is being opened: wait until it is shown")
        try:
            yield
        finally:
            self._opening.release()

    def start_again(self) -> None:
        """Open the cell with its last part again."""
        self._show_next(self._open_cell(self._part))

    def _show_next(self, opened: _Opened) -> None:
        with self._lock:
            dropped, self._next = self._next, opened
        if dropped is not None:
            dropped.resources.close()

    def _open_cell(self, part: PartFile | None) -> _Opened:
        resources = ExitStack()
        session = resources.enter_context(self._open_session(part))
        name = None if part is None else part.path.name

        def make() -> View:
            self._part = part
            return Workspace(self._server, session, name, self._settings, self)

        return _Opened(make, resources)

    def _show(self, opened: _Opened) -> View:
        with self._lock:
            self._server.scene.reset()
            self._server.gui.reset()
            self._view = view = opened.make()
            for client in self._server.get_clients().values():
                client.scene.reset()
                client.gui.reset()
                view.join(client, self._is_wide[client.client_id])
        return view

    def _join(self, client: viser.ClientHandle) -> None:
        with self._lock:
            width, height = client.camera.image_width, client.camera.image_height
            # Before its first panels, the picture is as large as the window.
            self._is_wide[client.client_id] = width > _WIDE * height
            if self._view is not None:
                self._view.join(client, self._is_wide[client.client_id])

    def _leave(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._is_wide.pop(client.client_id, None)
            if self._view is not None:
                self._view.leave(client)


def _nothing() -> None:
    """Do nothing."""


def serve_workspace(
    open_session: OpenSession,
    part: PartFile | None = None,
    *,
    host: str = LOOPBACK,
    port: int = 8080,
    settings: WorkspaceSettings | None = None,
    started: Callable[[str], None] = lambda _: None,
    stop: Event | None = None,
) -> None:
    """Show a live cell in browsers until `stop` is set.

    Parameters
    ----------
    open_session
        Starts the cell with a part, or an empty table.
    port
        To listen on; the next free port is used if it is in use.
    settings
        Settings of the workspace.
    started
        Receives the address to open.

    Raises
    ------
    ScancellError
        If viser is not installed, the part cannot be loaded, or the FMU reports an error.
    """
    with quiet_server(host, port) as server:
        cell = Host(server, open_session, settings or WorkspaceSettings())
        cell.run(part, stop or Event(), lambda: started(address(server)))
