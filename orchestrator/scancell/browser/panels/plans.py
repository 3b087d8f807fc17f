"""The plan in the workspace: selected pose, playback, and the ghost that shows it in all browsers."""

from __future__ import annotations

from collections.abc import Callable
from threading import RLock
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from scancell.browser.scene.scene import CellScene
from scancell.errors import CommandError
from scancell.live.plan import LivePlan, LivePlanState, MapPose
from scancell.planning.path_map.configuration_map import ConfigurationMap
from scancell.planning.plan import Plan
from scancell.views.motion import ProgramMotion

Array = NDArray[np.float64]


class Plans:
    """Selects one pose of the plan: a cell of a map, or a time of the program. All methods are thread-safe.

    Parameters
    ----------
    plans
        Makes plans, and moves the robot.
    scene
        Shows the ghost.
    has_part
        Whether something stands on the table.
    clock
        s.

    Attributes
    ----------
    path, branch
        Numbers of the sensor path and arm branch whose map is selected.
    share, angle
        Selected cell of that map: share of the time along the path, 0 to 1, and angle of the table, rad.
    time
        Of the program, s.
    """

    def __init__(
        self, plans: LivePlan, scene: CellScene, has_part: bool = True, clock: Callable[[], float] = monotonic
    ) -> None:
        self._plans, self._scene, self._has_part, self._clock = plans, scene, has_part, clock
        self._lock = RLock()
        self._plan: Plan | None = None
        self._motion: ProgramMotion | None = None
        self._picked: MapPose | None = None
        self._axes: Array | None = None
        self._what = ""
        self._playing, self._before = False, 0.0
        self.path = self.branch = 0
        self.share = self.angle = self.time = 0.0

    @property
    def state(self) -> LivePlanState:
        """Progress of the plan."""
        return self._plans.state

    @property
    def hindrance(self) -> str:
        """Reason why no plan can be made now; empty if one can."""
        if not self._has_part:
            return "the table is empty: open a part first"
        return "a plan is being made: wait for it" if self.state.stage in ("planning", "evaluating") else ""

    @property
    def plan(self) -> Plan | None:
        """The plan that is shown."""
        return self._plan

    @property
    def motion(self) -> ProgramMotion | None:
        """Motion of the plan."""
        return self._motion

    @property
    def picked(self) -> MapPose | None:
        """The selected cell of the map; None while a time is selected."""
        return self._picked

    @property
    def map(self) -> ConfigurationMap | None:
        """The selected map; None before it is evaluated."""
        return self._plans.map_of(self.path, self.branch)

    @property
    def plays(self) -> bool:
        """Whether playback of the plan is running."""
        return self._playing

    def start(self) -> None:
        """Make the plan; see `LivePlan.start`."""
        self._plans.start()

    def choose_map(self, path: int, branch: int | None = None) -> None:
        """Select the map of a path in a branch, by default the planned one; see `LivePlan.evaluate`."""
        if self._plan is None:
            raise CommandError("there is no plan: make one first")
        number = self._plan.paths[path].lattice.map.branch if branch is None else branch
        self._plans.evaluate(path, number)
        with self._lock:
            self.path, self.branch, self._picked = path, number, None

    def pick(self, share: float, angle: float) -> None:
        """Select a cell of the map; see `LivePlan.judge`."""
        picked = self._plans.judge(self.path, self.branch, share, angle)
        with self._lock:
            self.share, self.angle, self._picked, self._playing = share, angle, picked, False
            self._select(picked.axes, "the pose in the map", bool(picked.reason))

    def go_to_time(self, time: float) -> None:
        """Select a time of the program, s."""
        with self._lock:
            if self._motion is None or self._plan is None:
                raise CommandError("there is no plan: make one first")
            self.time, self._picked = float(np.clip(time, 0.0, self._motion.duration)), None
            name = self._plan.program.segments[self._motion.segment_at(self.time)].name
            self._select(self._motion.axes(self.time), f"{self.time:.1f} s of the plan ({name})", False)

    def play_or_pause(self) -> None:
        """Play the plan, from the start after its end, or pause."""
        with self._lock:
            if self._motion is None:
                raise CommandError("there is no plan: make one first")
            self._playing, self._before = not self._playing, self._clock()
            if self._playing:
                self.go_to_time(self.time if self.time < self._motion.duration else 0.0)

    def hide(self) -> None:
        """Hide the ghost."""
        with self._lock:
            self._playing, self._picked = False, None
            self._select(None, "", False)

    def move_robot(self) -> None:
        """Move the arm and the table to the selected pose; see `LivePlan.go_to`.

        Raises
        ------
        CommandError
            If no pose is selected, or it is out of reach.
        """
        with self._lock:
            self._playing = False
            axes, what = self._axes, self._what
        if axes is None:
            raise CommandError(self.unselected)
        self._plans.go_to(axes, what)

    @property
    def unselected(self) -> str:
        """Reason why no pose is selected to which the robot could move; empty if one is."""
        if self._axes is not None:
            return ""
        return self._picked.reason if self._picked is not None else "choose a pose of the plan first"

    def update(self) -> None:
        """Show a new plan, and advance the playback; one thread calls this periodically."""
        with self._lock:
            if self._plans.plan is not self._plan:
                self._take(self._plans.plan)
            if self._playing and self._motion is not None:
                now = self._clock()
                self.go_to_time(self.time + now - self._before)
                self._before = now
                self._playing = self.time < self._motion.duration

    def _take(self, plan: Plan | None) -> None:
        self.hide()
        self._plan, self.time, self.path = plan, 0.0, 0
        self._motion = None if plan is None else ProgramMotion(plan.program)
        if plan is not None and plan.paths:
            self.branch = plan.paths[0].lattice.map.branch

    def _select(self, axes: Array | None, what: str, forbidden: bool) -> None:
        self._axes, self._what = axes, what
        self._scene.show_preview(axes, forbidden)
