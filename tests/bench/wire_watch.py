"""Paired runs of a watch beside the simulated UR: ``python -m bench.wire_watch [--runs N] [--first N]``.

PYTHONPATH=tests:tests/orchestrator. Each run is a program of one move, straight or by the joints, to a random pose
over, beside or in the table, with a watchdog on the silence of the watch: once without a watch and once with it, whose
orders are late and lost.
"""

from __future__ import annotations

import argparse
import contextlib
from collections import defaultdict

import numpy as np

import scancell
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.wire.ur.controller import UrController
from scancell.wire.ur.variables import pose_vector
from scancell.wire.ur.watch import UrWatch
from scancell.wire.watch import Watch
from wire_ur import CELL, WatchedRun, controller_of, watched_run

DELAYS_MS = (8, 50, 100, 200)  # from a state to the arrival of its order
WATCHDOG_HZ = 10.0
SPEEDS = (0.1, 0.3, 1.0)  # rad/s, and as many tenths of m/s


def program(controller: UrController, rng: np.random.Generator, speed: float) -> str:
    robot = controller.robot
    while True:
        turn = pose.rotation_from_euler_xyz(
            (np.pi + rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), rng.uniform(-2, 2))
        )
        place = (0.45 + rng.uniform(-0.2, 0.2), rng.uniform(-0.25, 0.25), rng.uniform(0.05, 0.35))
        goal = pose.from_rotation(turn, place)
        try:
            joints = robot.joints_for(goal)
        except CommandError:
            continue
        if np.abs(joints - robot.targets).max() < 2.5:
            break
    move = f"movej({joints.tolist()}, v={speed})"
    if rng.random() < 0.5:
        move = f"movel(p{pose_vector(goal).tolist()}, v={0.4 * speed})"
    return f'def f():\n  rtde_set_watchdog("input_int_register_24", {WATCHDOG_HZ}, "stop")\n  {move}\nend'


def run(
    controller: UrController, number: int, delay_ms: float, speed: float, guard: scancell.Guard
) -> tuple[WatchedRun, WatchedRun, bool]:
    """The run without and with a watch, and whether the move was refused at once."""
    loss, robot = float(np.random.default_rng(number).choice([0.0, 0.02, 0.1])), controller.robot
    found = []
    for is_watched in (False, True):
        controller.run_script(f"movej({robot.home.tolist()}, v=3)")
        while controller.is_running:
            controller.step()
        refused, rng = controller.refusals.total(), np.random.default_rng(number)
        script, watch = program(controller, rng, speed), None
        if is_watched:
            guard.reset()
            watch = UrWatch(Watch(guard, np.append(robot.home, 0.0)), guard.settings.max_age)
        else:
            script = "\n".join(line for line in script.split("\n") if "watchdog" not in line)
        found.append(watched_run(controller, script, watch, delay_ms * 1e-3, loss, rng))
    return found[0], found[1], controller.refusals.total() > refused


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    # The largest age covers the delay, the silence until the watchdog, and two cycles.
    guards = {delay: scancell.guard_of(CELL, max_age=delay * 1e-3 + 1 / WATCHDOG_HZ + 0.004) for delay in DELAYS_MS}
    rows: defaultdict[tuple[int, float], np.ndarray] = defaultdict(lambda: np.zeros(6, int))
    with controller_of() as controller, contextlib.suppress(KeyboardInterrupt):
        for number in range(options.first, options.first + options.runs):
            delay, speed = DELAYS_MS[number % 4], SPEEDS[number // 4 % 3]
            alone, watched, refused = run(controller, number, delay, speed, guards[delay])
            if refused:
                continue
            is_harmless, what = not alone.contacts, f"at {delay} ms, {speed} rad/s"
            is_false = is_harmless and bool(watched.stop)
            if watched.contacts:
                print(f"run {number}: CONTACT {watched.contacts} {what}", flush=True)
            if is_false:
                print(f"run {number}: false stop {what}: {watched.stop}", flush=True)
            slowed = is_harmless and watched.slowed > 0
            counts = (1, not is_harmless, bool(watched.contacts), is_harmless, is_false, slowed)
            rows[delay, speed] += np.array(counts, int)
    print("| delay | speed | runs | contacts alone | contacts watched | harmless | false stops | slowed |")
    print("|---|---|---|---|---|---|---|---|")
    for (delay, speed), row in sorted(rows.items()):
        print(f"| {delay} ms | {speed} rad/s | {' | '.join(map(str, row))} |")
    print(f"| all | | {' | '.join(map(str, sum(rows.values())))} |")


if __name__ == "__main__":
    main()
