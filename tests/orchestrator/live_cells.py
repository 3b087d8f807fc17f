"""Live cells in simulated time: stepped by a test, or by another thread as fast as it can."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager

import numpy as np

from scancell.live.cell import LiveCell
from scancell.live.state import Command, LiveState, MoveTool
from scancell.scanning.session import ScanSession

MAX_CYCLES = 20_000
PATIENCE = 120  # s: only ends tests that hang


class SteppedCell:
    """A live cell whose states are kept, whose clock advances with its cycles, and in which events happen at cycles."""

    def __init__(self, session: ScanSession, hold_time: float = 0.3) -> None:
        self.session, self.now = session, 100.0
        self.live = LiveCell(session, hold_time, lambda: self.now)
        self.states: list[LiveState] = []
        self.events: dict[int, Callable[[], object]] = {}
        session.cell.on_cycle(round(session.cycle * 1e6), self._end_cycle)
        self.cycle(8)

    def _end_cycle(self) -> None:
        if (event := self.events.pop(len(self.states), None)) is not None:
            event()
        self.now += self.session.cycle
        self.states.append(self.live.state)

    def after(self, count: int, event: Callable[[], object]) -> None:
        """Let something happen at the end of a cycle from now."""
        self.events[len(self.states) + count] = event

    def cycle(self, count: int = 1, *commands: Command) -> LiveState:
        """Step, with the commands before each cycle."""
        for _ in range(count):
            for command in commands:
                self.live.submit(command)
            self.live.step()
        return self.live.state

    def until(self, condition: Callable[[LiveState], bool], *commands: Command) -> LiveState:
        for _ in range(1500):
            if condition(state := self.cycle(1, *commands)):
                return state
        raise AssertionError(f"the condition never held: {self.live.state}")

    def rests(self) -> LiveState:
        self.cycle(2)
        return self.until(lambda state: not state.moving)

    def at(self, target: np.ndarray) -> None:
        """Move the sensor to a pose."""
        self.live.submit(MoveTool(target))
        self.cycle(4)
        self.rests()

    def stop_in(self, count: int, job: Callable[[ScanSession], object], by: Callable[[], object]) -> Future[object]:
        """A job that is stopped after `count` cycles."""
        self.after(count, by)
        done = self.live.perform(job, "the job")
        self.cycle(2)
        return done

    @property
    def touched(self) -> bool:
        return any(state.colliding for state in self.states)


def run_until(live: LiveCell, condition: Callable[[], bool]) -> None:
    """Run a cell in this thread, as fast as it can, until a condition holds; fails instead of hanging."""
    last = live.state.time + MAX_CYCLES * 0.016
    live.run(lambda: condition() or live.state.time > last, realtime=False)
    assert condition(), live.state


@contextmanager
def running(live: LiveCell) -> Iterator[LiveCell]:
    """Run a cell in another thread, as fast as it can."""
    ended = threading.Event()
    thread = threading.Thread(target=live.run, args=(ended.is_set, False))
    thread.start()
    try:
        yield live
    finally:
        ended.set()
        thread.join(PATIENCE)
