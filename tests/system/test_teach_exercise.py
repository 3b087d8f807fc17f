"""Exercise 7 of docs/exercises.md, walked through the server of the workspace: teach, run, animate."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import PARTS, scancell_here

from remote_browser import RemoteBrowser
from scancell import Scanner
from scancell.browser.server.gate import address
from scancell.browser.server.serve import Host
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.config.loading import load_setup
from scancell.geometry.fits import fit_sphere
from scancell.programs.taught import program_text, read_program
from scancell.reconstruction.cloud_files import read_ply
from tour import hosted

SOLUTION = Path(__file__).parents[2] / "docs" / "examples" / "exercises" / "taught.py"
WAITS = 300.0  # s: only a hang takes longer


@dataclass
class Student:
    """One browser of the workspace."""

    host: Host
    browser: RemoteBrowser

    def goes_to(self, x: float, z: float) -> None:
        """Bring the sensor above the table, looking down; mm."""
        self.browser.enter("x, y, z, mm", [x, 0.0, z])
        self.browser.enter("XYZ' angles, deg", [180.0, 0.0, 0.0])
        self.browser.press("Move to this pose")
        self.waits(lambda sensor: np.allclose(sensor, (1e-3 * x, 0.0, 1e-3 * z), atol=1e-5))

    def waits(self, condition: Any) -> None:
        """Wait until the robot rests and the position of the sensor meets a condition."""
        assert self.host.workspace is not None
        live, nominal = self.host.workspace.live, self.host.workspace.nominal
        end = time.monotonic() + WAITS
        while live.state.moving or not condition(nominal.world_from_sensor(live.state.joints)[:3, 3]):
            assert time.monotonic() < end, live.state
            time.sleep(0.02)

    def adds(self, kind: str, name: str, label: str) -> None:
        self.browser.enter("kind", kind)
        self.browser.enter("name", name)
        self.browser.press("Add after this step")
        self.browser.shows(label)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of the workspace in which the exercise was walked."""
    folder = tmp_path_factory.mktemp("exercise") / "out"
    settings = WorkspaceSettings(folder, "geometric")
    with (
        Scanner(setup=load_setup(ideal=True), threads=1) as scanner,
        hosted(scanner, PARTS / "sphere_on_foot.stl", settings) as (host, server),
        RemoteBrowser(address(server)) as browser,
    ):
        assert host.workspace is not None
        host.workspace.feed.wanted = False
        student = Student(host, browser)
        browser.enter("step speed, %", 100)
        student.goes_to(450.0, 300.0)
        student.adds("joints", "above", "1 above: joints")
        student.goes_to(432.0, 260.0)
        student.adds("line", "start", "2 start: line")
        student.goes_to(468.0, 260.0)
        student.adds("scan line", "end", "3 end: scan line, 0.5 mm")
        browser.enter("step", "1 above: joints, table at 0.0°, 100 %")
        browser.enter("this step", "Copy")
        browser.shows("2 above: joints")
        browser.enter("this step", "Down")
        browser.shows("3 above: joints")
        browser.enter("this step", "Down")
        browser.shows("4 above: joints")
        browser.press("Run the program")
        browser.shows("recorded: ")
    yield folder


def test_taught_program_holds_the_steps(out: Path) -> None:
    taught, solution = (read_program(file.read_text(), file.name) for file in (out / "taught.py", SOLUTION))
    assert [(s.command, s.point) for s in taught.steps] == [(s.command, s.point) for s in solution.steps]
    for name in ("start", "end"):
        poses = [program.points[name].world_from_tool for program in (taught, solution)]  # type: ignore[union-attr]
        np.testing.assert_allclose(*poses, atol=2e-5)


def test_solution_is_as_the_workspace_writes_it() -> None:
    text = SOLUTION.read_text()
    written = program_text(read_program(text, "taught.py"))
    without_docs = [line for line in text.splitlines() if '"""' not in line]
    assert [line for line in written.splitlines() if '"""' not in line] == without_docs


def test_run_measures_the_sphere_and_is_animated(out: Path, tmp_path: Path) -> None:
    """Its radius is 25 mm; only the sphere is higher than 60 mm."""
    points = read_ply(out / "program_1" / "cloud.ply").points_in_part
    sphere = fit_sphere(points[points[:, 2] > 0.06])
    assert sphere.radius == pytest.approx(25e-3, abs=10e-6)
    animation = ("--size", "160x120", "--seconds", "0.2", "--fps", "10", "--out", "a.webp")
    done = scancell_here("animate", out / "program_1", *animation, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.last_line["figures"]["frames"] == 2
    assert (tmp_path / "a.webp").stat().st_size > 0
