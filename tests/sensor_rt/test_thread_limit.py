"""Parallel loops where the system starts no further threads."""

from __future__ import annotations

import subprocess
import sys

# The stack of a thread does not fit into what is left of the address space.
PROGRAM = """
import resource
import threading

import numpy as np

from scancell.sensor import MeshSurface

points = np.random.default_rng(1).normal(size=(20_000, 3))
vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
surface = MeshSurface(vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
expected = surface.signed_distances(points, threads=1)
with open("/proc/self/statm") as file:
    used = int(file.read().split()[0]) * resource.getpagesize()
for room_mb in (6, 14, 22):  # for none, one and two threads
    resource.setrlimit(resource.RLIMIT_AS, (used + (room_mb << 20), resource.RLIM_INFINITY))
    if room_mb == 6:
        try:
            threading.Thread(target=print).start()
            raise SystemExit("the system still starts threads")
        except RuntimeError:
            pass
    for found, value in zip(surface.signed_distances(points, threads=8), expected, strict=True):
        np.testing.assert_array_equal(found, value)
print("equal")
"""


def test_loops_run_on_fewer_threads_where_the_system_starts_no_more() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "equal\n"), done.stderr
