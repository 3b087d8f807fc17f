"""A cell at the limits of what its guard assumes.

Its axes brake no harder than that, and its controller begins to brake as late as it may.  What else a guard keeps clear
of is made small: noise, errors of bodies, what a person can change unseen.  Braking takes long.  So an error of the
guard leads to a contact sooner than in other cells.
"""

from __future__ import annotations

from dataclasses import dataclass

from scancell.config.cell import CellDescription
from scancell.guard.guard import GuardSettings
from scancell.scanning.session import settings_of

_WEAKER = 0.05  # accelerations of the axes, of those described
_PLACID = 0.1  # accelerations of jogs, of those described
_CYCLES = 8  # of the controller, that an answer permits motion
_NOISE = 2e-6  # rad, and m
_ERROR = 1e-4  # m


@dataclass(frozen=True)
class Limits:
    """A cell as its guard assumes it, and as it is.

    Attributes
    ----------
    assumed, true
        Descriptions.
    settings
        Of the guard.
    max_age
        Of the controller, s.
    """

    assumed: CellDescription
    true: CellDescription
    settings: GuardSettings
    max_age: float


def at_limits(described: CellDescription) -> Limits:
    """The cell at its limits."""
    settings = settings_of(described)
    motion = described.robot.motion
    placid = {
        name: _PLACID * getattr(motion, name) for name in ("jog_acceleration_mm_s2", "jog_turn_acceleration_deg_s2")
    }
    assumed = _weaker(described, _WEAKER)
    robot = assumed.robot.model_copy(update={"motion": motion.model_copy(update=placid)})
    assumed = assumed.model_copy(update={"robot": robot})
    narrow = GuardSettings(
        max_age=_CYCLES * settings.cycle,
        cycle=settings.cycle,
        noise=_NOISE,
        angle_error=5 * _NOISE,
        position_error=_ERROR,
        mesh_error=2 * _ERROR,
    )
    # Ages are whole cycles: the controller brakes at an age of the reaction time.
    return Limits(assumed, _weaker(assumed, narrow.deceleration), narrow, narrow.reaction - narrow.cycle / 2)


def _weaker(described: CellDescription, share: float) -> CellDescription:
    """The cell with a share of the acceleration limits of its axes."""
    joints = tuple(
        joint.model_copy(update={"max_acceleration_deg_s2": share * joint.max_acceleration_deg_s2})
        for joint in described.robot.joint
    )
    table = described.table.model_copy(
        update={"max_acceleration_deg_s2": share * described.table.max_acceleration_deg_s2}
    )
    further = []
    for axis in described.axis:
        key = f"max_acceleration{axis.unit}_s2"
        further.append(axis.model_copy(update={key: share * getattr(axis, key)}))
    robot = described.robot.model_copy(update={"joint": joints})
    return described.model_copy(update={"robot": robot, "table": table, "axis": tuple(further)})
