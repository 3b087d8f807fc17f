"""Programs in V+ and URScript: what they command, what is refused with its line, and damaged programs."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scancell.errors import CommandError, ProgramError
from scancell.geometry import pose
from scancell.programs.program import read_script
from scancell.programs.robot import deg, location, mm
from scancell.programs.script import Script
from scancell.programs.urscript import UrScript, pose_vector, vector_pose
from scancell.programs.vplus import VPlus, euler_location, euler_numbers

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "scan_passes.v2"
FLANGE_FROM_SENSOR = pose.translation((0.0, 0.0, 80 * mm))
MOST_COMMANDS = 300

UR = """\
def scan():
  def over(height):
    return pose_trans(p[0.45, 0, 0.1, 0, 0, 0], p[0, 0, height, 3.14159265, 0, 0])
  end
  global passes = 2
  count = 0
  set_tcp(p[0, 0, 0.08, 0, 0, 0])
  movej([0.6, -1.0, 3.2, 0, 0.9, 0], a=1.4, v=1.05)
  while count < passes:  # each with exposures
    movel(over(0.13), v=0.1)
    write_output_float_register(2, 0.0005)
    set_standard_digital_out(1, True)
    movel(over(0.14), a=1.2, v=0.05)
    set_standard_digital_out(1, False)
    count = count + 1
    if count == 1:
      textmsg("pass ", count)
    elif not get_standard_digital_out(1) and count >= 2:
      sleep(0.1)
    else:
      halt()
    end
  end
end
"""


class CommandLog:
    """A robot that notes its commands, at the end of which time has passed."""

    line_speed, axis_speeds = 1.0, np.full(7, 3.0)

    def __init__(self) -> None:
        self.time, self.joints, self.table_angle = 0.0, np.zeros(6), 0.0
        self.tool, self.commands = location(400 * mm, 0, 300 * mm, rx=180 * deg), list[tuple[Any, ...]]()

    def __getattr__(self, command: str) -> Any:
        def note(*arguments: Any) -> None:
            self.commands.append((command, *arguments))
            self.time += 0.016
            if len(self.commands) > MOST_COMMANDS:
                raise CommandError("the program goes on")
            if command in ("move_line", "move_tool", "scan_line"):
                self.tool = arguments[0]
            elif command == "move_joints":
                self.joints = arguments[0]

        return note

    def world_from_frame(self, _: str) -> np.ndarray:
        return np.eye(4)

    def world_from_tool(self, _: str = "") -> np.ndarray:
        return self.tool

    def flange_from_tools(self) -> dict[str, np.ndarray]:
        return {"sensor": FLANGE_FROM_SENSOR}

    def presence(self, number: int) -> bool:
        return number == 1

    def wait_until(self, condition: Any, what: str) -> None:
        self.__getattr__("wait_until")(what)
        if not condition():
            raise CommandError(f"timed out waiting for {what}")

    def named(self, *names: str) -> list[tuple[Any, ...]]:
        return [one for one in self.commands if one[0] in names]


def run(script: Script) -> tuple[CommandLog, list[str]]:
    robot, said = CommandLog(), list[str]()
    script.run(robot, said.append)  # type: ignore[arg-type]
    return robot, said


def vplus(*lines: str) -> tuple[CommandLog, list[str]]:
    return run(VPlus(Path("p.v2"), "\n".join([".PROGRAM main()", *lines, ".END"])))


@pytest.mark.parametrize("angles", [(10, 20, 30), (-170, 90, 5), (40, 0, 0), (0, 180, 25), (12, 180, 0)])
def test_yaw_pitch_roll_are_zyz_and_come_back(angles: tuple[float, ...]) -> None:
    made = euler_location(1, -2, 3, *angles)
    expected = pose.rotation_about(2, angles[0] * deg) @ pose.rotation_about(1, angles[1] * deg)
    np.testing.assert_allclose(made[:3, :3], expected @ pose.rotation_about(2, angles[2] * deg), atol=1e-12)
    np.testing.assert_allclose(euler_location(*euler_numbers(made)), made, atol=1e-12)


def test_rotation_vectors_come_back() -> None:
    for numbers in ([0.1, 0.2, 0.3, 0, 0, 0], [1, 2, 3, 0.5, -0.4, 2.0], [0, 0, 0, np.pi, 0, 0]):
        made = vector_pose(np.array(numbers, float))
        np.testing.assert_allclose(vector_pose(pose_vector(made)), made, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 + 2*3 - 4/8", 6.5),
        ("-(2) * -3", 6),
        ("7 MOD 4", 3),
        ("(1 == 1) AND NOT (2 > 3)", -1),
        ("TRUE XOR ON", 0),
        ("1 <> 1 OR 2 <= 1", 0),
        ("ABS(-2) + INT(2.9) + MAX(1, 3, 2) + MIN(4, 2)", 9),
        ("DX(TRANS(1, 2, 3):TRANS(10))", 11),
        ("DX(RZ(90):TRANS(0, 5))", -5),
        ("DY(SHIFT(RZ(90) BY 1, 2, 3):INVERSE(NULL))", 2),
        ("DISTANCE(TRANS(0, 0, 0), TRANS(3, 4))", 5),
        ("ATAN2(1, 1) + SIN(30) * SQRT(16) + COS(60)", 47.5),
        ("SIG(1001) AND SIG(-1002, -7)", -1),
    ],
)
def test_values_of_vplus(text: str, expected: float) -> None:
    (said,) = vplus(f"  x = {text}", "  TYPE /F12.6, x")[1]
    assert float(said) == pytest.approx(expected, abs=1e-6)


CONTROL = """\
$text = "a;b" + "c"
FOR i = 3 TO 1 STEP -1
  a[i] = i*i
END
n = 0
WHILE a[1] + n < 3 DO
  n = n + 1
END
DO
  n = n + 10
UNTIL n > 20
CASE n OF
  VALUE 1, 2:
    TYPE "few"
  VALUE 22: ; this one
    TYPE /I3, a[3], /D, " ", n, /C1, /X2, $text
  ANY
    TYPE "other"
END
IF n == 1 THEN
  TYPE "wrong"
ELSE
  TYPE "right", i
END
"""


def test_control_flow_and_arrays() -> None:
    assert vplus(*CONTROL.splitlines())[1] == ["  9 22\n  a;bc", "right0"]


def test_arguments_are_passed_by_reference_and_auto_variables_are_local() -> None:
    text = """\
.PROGRAM main()
  i = 5
  CALL count(i, 2 + 1, total)
  TYPE i, " ", total, " ", step.of
.END
.PROGRAM count(n, by, sum)
  AUTO REAL i
  i = 100
  n = n + by
  sum = n + i
  step.of = by
  by = 0
  RETURN
  TYPE "not reached"
.END
"""
    assert run(VPlus(Path("p.v2"), text))[1] == ["8 108 3"]


def test_motions_of_vplus() -> None:
    """Locations are relative to the base, APPRO and DEPART against the tool's z, SPEED without ALWAYS for one move."""
    robot, said = vplus(
        "SPEED 50, 80 ALWAYS",
        "SET p = TRANS(400, 0, 200, 0, 180, 0)",
        "APPRO p, 30",
        "SPEED 25 MMPS",
        "MOVES p:TRANS(10)",
        "DEPARTS 20",
        "MOVE #PPOINT(1, 2, 3, 4, 5, 6, 90)",
        "BREAK",
        "SPEED 40 MONITOR",
        "ACCEL 50",
        "ACCEL 60, 60",
    )
    speeds = [one[1] for one in robot.named("set_speed")]
    np.testing.assert_allclose(speeds, [0.5, 0.025, 0.5, 0.5])
    places = [one[1][:3, 3] / mm for one in robot.named("move_tool", "move_line")]
    np.testing.assert_allclose(places, [[400, 0, 230], [390, 0, 200], [390, 0, 220]], atol=1e-9)
    (joints,) = robot.named("move_joints")
    np.testing.assert_allclose(joints[1] / deg, [1, 2, 3, 4, 5, 6])
    assert joints[2] == pytest.approx(90 * deg)
    assert robot.named("set_monitor_speed") == [("set_monitor_speed", 0.4)]
    assert said == ["line 11: ACCEL: accelerations remain those of the cell's description"]


def test_signals_expose_at_rising_edges_and_along_motions() -> None:
    robot, _ = vplus(
        *("SIGNAL 1", "SIGNAL 1", "SIGNAL -1", "SIGNAL 1, -1"),
        *("trigger.interval = 0.5", "SIGNAL 2", "MOVES TRANS(400, 0, 200, 0, 180, 0)", "BREAK", "SIGNAL -2"),
        *("trigger.interval = 2", "SIGNAL 3", "MOVE #PPOINT(0, 0, 0, 0, 0, 0, 30)", "BREAK", "SIGNAL -3"),
        "MOVE #PPOINT(0, 0, 0, 0, 0, 0, 60)",
    )
    names = [one[0] for one in robot.commands if one[0] != "set_speed"]
    assert names == ["profile", "profile", "scan_line", "scan_table", "move_joints"]
    assert robot.named("scan_line")[0][2] == pytest.approx(0.5 * mm)
    assert robot.named("scan_table")[0][1:] == pytest.approx((30 * deg, 2 * deg))


def test_example_has_sixty_lines_and_runs() -> None:
    robot, said = run(read_script(EXAMPLE))
    assert len(EXAMPLE.read_text().splitlines()) >= 60
    assert len(robot.named("scan_line")) == len(robot.named("profile")) == 2
    assert said[1:] == ["pass 1:  40.00 mm", "pass 2:  40.00 mm", "some passes", "done"]


def test_statements_of_urscript() -> None:
    robot, said = run(UrScript(Path("p.script"), UR))
    assert said == ["pass  1.0"]
    assert len(robot.named("move_line")) == len(robot.named("scan_line")) == 2
    np.testing.assert_allclose(robot.named("scan_line")[0][1][:3, 3], [0.45, 0, 0.24], atol=1e-9)
    assert robot.named("scan_line")[0][2] == 0.0005
    # The third joint has the longest way, 3.2 rad, and would turn with 3 rad/s.
    np.testing.assert_allclose([one[1] for one in robot.named("set_speed")][:3], [1.05 / 3, 0.1, 0.05])


def test_table_of_urscript_turns_by_registers() -> None:
    text = """\
write_output_float_register(0, 1.5)
write_output_float_register(1, 0.3)
set_digital_out(3, True)
textmsg(get_digital_in(0))
set_digital_out(3, False)
textmsg(get_digital_in(0))
"""
    robot, said = run(UrScript(Path("p.script"), text))
    assert robot.named("turn_table") == [("turn_table", 1.5)]
    assert robot.named("set_speed") == [("set_speed", pytest.approx(0.1))]
    assert said == ["True", "False"]


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("GOTO 10", "GOTO 10: GOTO: no instruction that is known"),
        ("10 MOVE p", "is not understood here"),
        ("FOO", "FOO: no instruction"),
        ("x = FOO(1)", "FOO: no function"),
        ("CALL nobody(1)", "nobody: no program"),
        ("CALL main(1)", "main has 0 arguments"),
        ("MOVE", "missing a required argument"),
        ("MOVE p, p", "too many positional arguments"),
        ("MOVE p", "p has no value"),
        ("MOVE 5", "a number, expected a location"),
        ("MOVE #PPOINT(1, 2)", "2 axes, expected 6 joints, or 7 with the table"),
        ("MOVES #PPOINT(1, 2, 3, 4, 5, 6)", "6 numbers, expected a location"),
        ("SPEED 0 ALWAYS", "expected more than 0"),
        ("TOOL TRANS(0, 0, 70)", r"expected sensor at \(0.000, 0.000, 80.000\) mm"),
        ("SIGNAL 1000", "output 1000, expected 1 to 999"),
        ("SIGNAL 1.5", "expected a whole number"),
        ("x = 1/0", "division by zero"),
        ("x = 1E308*10", "not finite"),
        ("x = SQRT(-1)", "math domain error"),
        ('x = "a" + 1', "a text, expected a number"),
        ("TRUE = 1", "TRUE cannot be changed"),
        ("FOR i = 1 TO 3 STEP 0\nEND", "a step of 0"),
        ("WHILE TRUE DO\nEND", "an endless loop"),
        ("CALL main", "calls within each other"),
        ("TYPE /Q3, 1", "/Q3: no format"),
        ("IF TRUE THEN", "is not understood here"),
        ("WAIT SIG(1)", "timed out"),
        ("SIGNAL 2\nMOVES TRANS(400)", "trigger.interval has no value"),
        ("SIGNAL 2\nMOVE TRANS(400)", "expected a straight move"),
        ("MOVE TRANS(400)\nSIGNAL 2", "expected BREAK before"),
        ("MOVE TRANS(400)\nHERE p", "expected BREAK before"),
    ],
)
def test_vplus_refuses_with_line(statement: str, message: str) -> None:
    with pytest.raises(ProgramError, match=rf"p\.v2:[2-9]: .*{message}"):
        vplus(*statement.split("\n"))


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("servoj([0,0,0,0,0,0])", "servoj: no function"),
        ("thread t():", "is not understood here"),
        ("movej([0, 0, 0, 0, 0, 0], t=2)", "duration of a motion cannot be prescribed"),
        ("movej([0, 0])", "2 joints, expected 6"),
        ("movel([0, 0, 0, 0, 0, 0])", "expected a location"),
        ("movej([0, 0, 0, 0, 0, 0], vel=2)", "unexpected keyword argument 'vel'"),
        ("movel(p[0, 0, 0], v=1)", "a pose of 3 numbers"),
        ("movel(p[0.4, 0, 0.2, 0, 0, 0], v=0)", "expected more than 0"),
        ("x = [1, 2]\nx[0] = 3", "elements of lists cannot be changed"),
        ("x = [1, 2]\ny = x[2]", "expected 0 to 1"),
        ("x = sleep(1)", "sleep has no value"),
        ("set_digital_out(3, True)", "float register 0 has no value"),
        ("set_digital_out(1, True)\nmovel(p[0.4, 0, 0.2, 0, 0, 0])", "float register 2 has no value"),
        ("while True:\nend", "an endless loop"),
        ("set_tcp(p[0, 0, 0, 0, 0, 0])", "expected sensor at"),
    ],
)
def test_urscript_refuses_with_line(statement: str, message: str) -> None:
    last = 1 + statement.count("\n") - statement.endswith("end")
    with pytest.raises(ProgramError, match=rf"p\.script:{last}: .*{message}"):
        run(UrScript(Path("p.script"), statement))


def mutants(text: str, count: int, seed: int) -> Iterator[str]:
    """The text with one to four pieces deleted, repeated, swapped with others, or replaced by letters of it."""
    rng = random.Random(seed)
    for _ in range(count):
        pieces = re.findall(r"\s+|\w+|[^\w\s]", text)
        for _ in range(rng.randint(1, 4)):
            at, other = rng.randrange(len(pieces)), rng.randrange(len(pieces))
            match rng.randrange(5):
                case 0:
                    pieces[at] = ""
                case 1:
                    pieces[at] *= 2
                case 2:
                    pieces[at], pieces[other] = pieces[other], pieces[at]
                case 3:
                    pieces[at] = rng.choice(
                        ["(", ")", "\n", '"', "1e400", "-", ":", "[", "\x00", "é", "0", ".END", "end"]
                    )
                case 4:
                    pieces[at] = "".join(rng.sample(pieces[at], len(pieces[at])))
        yield "".join(pieces)


def outcome(kind: type[Script], text: str) -> str:
    """What becomes of a damaged program: empty, or its message with file and line; anything else fails."""
    try:
        run(kind(Path("p"), text))
    except ProgramError as error:
        assert re.match(r"p:\d+: ", str(error)), error
        return str(error)
    return ""


VPLUS = f"""\
.PROGRAM main()
{CONTROL}
  MOVES TRANS(400, 0, 200):SHIFT(NULL BY 1, 2, 3)
  BREAK
  CALL s(n)
.END
.PROGRAM s(a)
  SPEED a MMPS ALWAYS
  SIGNAL 1, -a
  RETURN
.END
"""


@pytest.mark.parametrize(("kind", "text"), [(VPlus, VPLUS), (UrScript, UR)])
@pytest.mark.parametrize("count", [150, 5000])
def test_damaged_programs_are_refused_with_line_or_run(kind: type[Script], text: str, count: int) -> None:
    outcomes = [outcome(kind, mutant) for mutant in mutants(text, count, seed=count)]
    assert outcome(kind, text) == ""
    assert sum(map(bool, outcomes)) > count / 4
    assert "" in outcomes


@pytest.mark.parametrize("text", ["", "\n", "x" * 2_000_001, ".PROGRAM", "(" * 5000, "\x00", ";" * 10])
@pytest.mark.parametrize("kind", [VPlus, UrScript])
def test_odd_texts_are_refused(kind: type[Script], text: str) -> None:
    with pytest.raises(ProgramError, match=r"^p(:\d+)?: "):
        run(kind(Path("p"), text))


@pytest.mark.parametrize("kind", [VPlus, UrScript])
def test_deep_expressions_end(kind: type[Script]) -> None:
    text = f"x = {'(' * 3000}1{')' * 3000}{' + 1' * 3000}"
    outcome(kind, f".PROGRAM main()\n{text}\n.END" if kind is VPlus else text)
