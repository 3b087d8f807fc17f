"""Conditions of inputs: functions of the state that return the reason why an input cannot work now, or nothing."""

from __future__ import annotations

from scancell.cell.controller import Operation
from scancell.live.state import LiveState

OTHER_OPERATOR = "another browser controls the cell: take control first"


def always(state: LiveState) -> str:
    """No condition."""
    return ""


def can_move(state: LiveState) -> str:
    """Moves need a cell without an emergency stop and without a job."""
    if state.controller == "emergency stop":
        return 'the robot is stopped: press "Reset after a stop" first'
    return _no_job(state)


def is_stopped(state: LiveState) -> str:
    """There is a stop to release."""
    return "" if state.controller == "emergency stop" else "the robot is not stopped"


def can_start(state: LiveState) -> str:
    """Jobs that do not move the robot need it at rest, stopped or not, and without another job."""
    return _no_job(state) or ("the robot moves: wait until it is at rest" if state.moving else "")


def can_jog(state: LiveState) -> str:
    """Jogs also need manual operation, which is chosen at rest."""
    if state.moving and state.operation is Operation.AUTOMATIC:
        return "the robot moves in automatic operation: wait until it is at rest"
    return can_move(state)


def _no_job(state: LiveState) -> str:
    return "" if state.job is None else f"{state.job} runs: end it first"


def can_end(state: LiveState) -> str:
    """A motion or a job that can be ended."""
    return "" if state.moving or state.job is not None else "nothing moves the robot"
