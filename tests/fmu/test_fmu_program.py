"""Programs in the FMU: execution, trigger gate, guard messages, pendant, states and invalid files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, START, Array, Build, CellFmu

from json_changes import changed

PROGRAM, HOLD = 6, 0
NO_SEGMENT, ELSEWHERE, TOO_FAST, GUARD_TIMEOUT = 8, 9, 10, 11
PATH_OUT_OF_LIMITS = 6
CYCLE = CYCLE_US * 1e-6
TIMES = np.arange(126) * CYCLE  # 2 s
TURN = 1.2  # rad, of the table
LEAD = 0.00025  # s, half an exposure
VERSIONS = pytest.mark.parametrize("version", [2, 3])


def eased(x: Array) -> Array:
    """From 0 to 1, at rest at both ends."""
    return x**3 * (10 - 15 * x + 6 * x**2)


def program_data() -> dict[str, Any]:
    """Segment 4 swings all joints while the table turns, segment 7 goes back."""
    x = TIMES / TIMES[-1]
    q = START + 0.2 * np.sin(np.pi * x)[:, None] ** 4 * np.arange(1, 7) / 6
    table = TURN * eased(x)
    segments = [(4, q, table), (7, q, table[::-1])]
    return {
        "format": 2,
        "segments": [
            {"id": number, "name": "", "time": TIMES.tolist(), "q": q.tolist(), "table": table.tolist()}
            for number, q, table in segments
        ],
        "exposures": "not for the FMU",
    }


def write(folder: Path, data: Any) -> Path:
    file = folder / "program.json"
    file.write_text(data if isinstance(data, str) else json.dumps(data))
    return file


def start(cell: CellFmu, file: Path | str, segment: int = 4) -> None:
    cell.set("command.program", str(file))
    cell.set("command.mode", PROGRAM)
    cell.set("command.segment", segment)
    cell.set("command.start", cell.get_int("command.start") + 1)


@VERSIONS
def test_segments_run_to_their_ends_exactly(build: Build, tmp_path: Path, version: int) -> None:
    cell = build(version)
    data = program_data()
    file = write(tmp_path, data)
    for segment in data["segments"]:
        start(cell, file, segment["id"])
        for q, table in zip(segment["q"][1:], segment["table"][1:], strict=True):
            cell.step(CYCLE_US)
            np.testing.assert_allclose(cell.vector("measured.q", 6), q, atol=1e-12)
            np.testing.assert_allclose(cell.get("measured.table"), table, atol=1e-12)
        assert cell.get_int("controller.at_destination")
        np.testing.assert_array_equal(cell.vector("measured.q", 6), segment["q"][-1])
        np.testing.assert_array_equal(cell.vector("controller.destination.q", 6), segment["q"][-1])
        assert cell.get("controller.progress", "controller.clock") == pytest.approx([1, TIMES[-1]])
        file.unlink(missing_ok=True)  # read once


def test_relative_path_begins_in_the_resources(build: Build) -> None:
    cell = build()
    resources = Path(cell.slave.unzipDirectory) / "resources"
    (resources / "own").mkdir(exist_ok=True)
    write(resources / "own", program_data())
    start(cell, "own/program.json")
    cell.step(CYCLE_US, 10)
    assert cell.get_int("controller.moving")


def exposures(cell: CellFmu, file: Path, mode: int, interval: float, speeds: Callable[[int], float]) -> Array:
    """Time and measured axes (n, 8) of the records of segment 4, with the trigger gate from 0.5 to 1.6 s."""
    cell.trigger(mode, interval, exposure=2 * LEAD, segment=4)
    cell.set("command.trigger.from", 0.5)
    cell.set("command.trigger.to", 1.6)
    start(cell, file)
    rows: dict[int, Array] = {}
    columns = ["trigger.time", *(f"trigger.measured.q[{i}]" for i in range(1, 7)), "trigger.measured.table"]
    for k in range(20_000):
        cell.set("command.monitor_speed", speeds(k))
        cell.step(1000)
        index = cell.get_int("trigger.index")
        if index:
            rows[index] = cell.get(*columns)
        if k > 16 and cell.get_int("controller.at_destination") and not cell.get_int("trigger.queued"):
            break
    assert len(rows) == cell.get_int("trigger.count")
    return np.array(list(rows.values()))


@pytest.mark.parametrize(("mode", "interval"), [(2, 0.02), (3, 0.002)])
def test_speed_override_does_not_change_poses_of_exposures(
    build: Build, tmp_path: Path, mode: int, interval: float
) -> None:
    file = write(tmp_path, program_data())
    random = np.random.default_rng(3).uniform(0.1, 1.0, 200)
    full = exposures(build(), file, mode, interval, lambda _: 1.0)
    slowed = exposures(build(), file, mode, interval, lambda k: float(random[k // 230]))
    assert len(full) == len(slowed) > 20
    assert slowed[-1, 0] > 1.3 * full[-1, 0]
    # Exposures begin at whole microseconds and early by LEAD at the speed of that instant. No axis is faster than the
    # table; its speed changes by its acceleration and by that of the path clock, at most 4 per s.
    speed, acceleration = TURN * 1.875 / TIMES[-1], TURN * 5.774 / TIMES[-1] ** 2
    bound = 1e-6 * speed + 0.5 * (acceleration + 4.0 * speed) * LEAD**2
    assert np.abs(full[:, 1:] - slowed[:, 1:]).max() < bound
    # The middle of the first exposure is at the gate.
    at_gate = TURN * eased(np.array([0.5 / TIMES[-1]]))
    assert full[0, -1] == pytest.approx(at_gate[0], abs=2e-6)


def test_gate_is_closed_without_running_segment(build: Build, tmp_path: Path) -> None:
    cell = build()
    cell.set("command.mode", PROGRAM)
    cell.trigger(1, 0.01)
    cell.step(CYCLE_US, 10)
    assert cell.get_int("trigger.count") == 0
    start(cell, write(tmp_path, program_data()))
    cell.step(CYCLE_US, 140)
    assert cell.get_int("trigger.count") == 201  # every 10 ms from 0 to 2 s
    cell.set("command.mode", HOLD)
    cell.step(CYCLE_US)
    assert cell.get_int("trigger.count") > 201


SEGMENT = program_data()["segments"][0]
WRONG = [
    ("segments.1.table", ..., "segments[1].table: missing key"),
    ("format", 3, "format: expected an integer from 2 to 2, got 3"),
    ("segments.0.q.2", [0.0] * 5, "segments[0].q[2]: expected an array of length 6"),
    ("segments.0.table", SEGMENT["table"][:-1], "segments[0].table: expected an array of length 126"),
    (
        "segments.0.time",
        (TIMES * 1.5).tolist(),
        "segments[0].time[1]: expected a set-point in every controller cycle, here at 0.016000 s, got 0.024",
    ),
    ("segments.0.table.5", 1e300, "segments[0].table[5]: expected a number from -1e+06 to 1e+06, got 1e+300"),
    ("segments.0.q.3.1", "0.1", 'segments[0].q[3][1]: expected a finite number, got "0.1"'),
    ("segments.1.id", 4, "segments[1].id: expected an id that no other segment has, got 4"),
    (
        "segments.0",
        {**SEGMENT, **{key: SEGMENT[key][:1] for key in ("time", "q", "table")}},
        "segments[0].time: expected an array of length 2",
    ),
]


def expect_rejected(cell: CellFmu, error: int, message: str) -> None:
    """The command is rejected with a message in the log and on the pendant; the cell goes on."""
    before = cell.vector("measured.q", 6)
    cell.step(CYCLE_US, 10)
    assert cell.get_int("controller.error") == error
    assert any(message in text for text in cell.messages), cell.messages
    assert message in cell.get_string("pendant.text")
    np.testing.assert_array_equal(cell.vector("measured.q", 6), before)


@pytest.mark.parametrize(("path", "value", "message"), WRONG, ids=[message.split(":")[0] for *_, message in WRONG])
def test_wrong_file_is_rejected_with_key_value_and_expectation(
    build: Build, tmp_path: Path, path: str, value: Any, message: str
) -> None:
    cell = build(loggingOn=True)
    file = write(tmp_path, changed(program_data(), path, value))
    start(cell, file)
    expect_rejected(cell, NO_SEGMENT, f"{file}: {message}")
    write(tmp_path, program_data())  # a file that could not be read is read again
    start(cell, file)
    cell.step(CYCLE_US, 10)
    assert cell.get_int("controller.moving")
    assert cell.get_int("controller.error") == 0


@VERSIONS
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"format": 2, "segments": [{"id": 4, "time": [0, NaN]', "not valid JSON"),
        ('{"format": 2, "segments": [1e999]}', "not valid JSON"),
        ("[]", "expected an object, got []"),
        ("", "not valid JSON"),
    ],
)
def test_text_that_is_no_program_is_rejected(
    build: Build, tmp_path: Path, version: int, text: str, message: str
) -> None:
    cell = build(version, loggingOn=True)
    start(cell, write(tmp_path, text))
    expect_rejected(cell, NO_SEGMENT, message)
    other = build(version)
    other.restore(other.deserialize(cell.serialize(cell.save())), cell.time_us)
    assert other.get_string("pendant.text") == cell.get_string("pendant.text")


@pytest.mark.parametrize(
    ("file", "segment", "message"),
    [
        ("/no/such/file.json", 4, "cannot open the file '/no/such/file.json'"),
        ("", 4, "command.program is empty"),
        ("/", 4, "cannot read the file '/'"),
        ("/dev/zero", 4, "cannot read the file '/dev/zero': expected a regular file"),
        ("/proc/kmsg", 4, "not valid JSON"),  # its size is 0, and to read it waits for the kernel
        ("-", 4, "cannot open the file"),  # not the standard input
        (None, 5, "no segment has the id 5"),
    ],
)
def test_missing_file_and_segment_are_rejected(
    build: Build, tmp_path: Path, file: str | None, segment: int, message: str
) -> None:
    cell = build(loggingOn=True)
    start(cell, write(tmp_path, program_data()) if file is None else file, segment)
    expect_rejected(cell, NO_SEGMENT, message)


def test_named_pipe_and_large_file_are_no_programs(build: Build, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as large:
        large.truncate(257 << 20)
    for name, message in {"pipe": "expected a regular file", "large": "257 MiB; expected at most 256"}.items():
        cell = build(loggingOn=True)
        start(cell, str(tmp_path / name), 4)
        expect_rejected(cell, NO_SEGMENT, message)


def test_segments_that_the_arm_cannot_follow_are_rejected(build: Build, tmp_path: Path) -> None:
    file = write(tmp_path, program_data())
    cell = build(loggingOn=True)
    start(cell, file, 7)  # begins with the table turned
    expect_rejected(cell, ELSEWHERE, "axes are not at the start of the segment: axis 7")
    data = program_data()
    data["segments"][0]["q"][60][2] += 0.5
    cell = build(loggingOn=True)
    start(cell, write(tmp_path, data))
    expect_rejected(cell, TOO_FAST, "axis 3")
    for row in data["segments"][0]["q"][20:100]:
        row[2] = 100.0
    cell = build(loggingOn=True)
    start(cell, write(tmp_path, data))
    cell.step(CYCLE_US)
    assert cell.get_int("controller.error") in (PATH_OUT_OF_LIMITS, TOO_FAST)


@VERSIONS
def test_state_with_running_program_needs_no_file(build: Build, tmp_path: Path, version: int) -> None:
    cell = build(version)
    file = write(tmp_path, program_data())
    cell.trigger(3, 0.002, exposure=0.001, segment=4)
    cell.set("command.trigger.from", 0.5)
    cell.set("command.monitor_speed", 0.7)
    start(cell, file)
    cell.step(CYCLE_US, 60)
    file.unlink()
    state = cell.save()
    data, begin = cell.serialize(state), cell.time_us

    def run_on(other: CellFmu) -> Array:
        rows = []
        for number in (4, 7):
            while not other.get_int("controller.at_destination"):
                other.step(1000)
            rows.append(other.get("measured.table", "trigger.time", "controller.clock", "trigger.measured.q[1]"))
            start(other, file, 7)
            other.step(CYCLE_US)
            assert other.get_int("controller.error") == 0 or number == 7
        return np.array(rows)

    first = run_on(cell)
    cell.restore(state, begin)
    np.testing.assert_array_equal(run_on(cell), first)
    fresh = build(version)
    fresh.restore(fresh.deserialize(data), begin)
    np.testing.assert_array_equal(run_on(fresh), first)


@VERSIONS
def test_guard_message_age_slows_and_stops(build: Build, tmp_path: Path, version: int) -> None:
    cell = build(version)
    cell.set("command.guard.max_age", 0.4)
    cell.set("command.pendant.text", "hello")
    start(cell, write(tmp_path, program_data()))
    for _ in range(30):
        cell.set("command.guard.time", cell.time_us * 1e-6)
        cell.step(CYCLE_US)
    assert cell.get("controller.guard.age")[0] == pytest.approx(CYCLE)
    assert cell.get("controller.rate")[0] == 1
    assert cell.get_string("pendant.text") == "hello"
    texts, rates = set(), []
    for _ in range(40):
        cell.step(CYCLE_US)
        texts.add(cell.get_string("pendant.text"))
        age, rate = cell.get("controller.guard.age", "controller.rate")
        rates.append((age, rate))
        assert rate == pytest.approx(np.clip(2 - 2 * age / 0.4, 0, 1), abs=1e-9)
    assert cell.get_int("controller.error") == GUARD_TIMEOUT
    assert cell.get_int("controller.mode") == PROGRAM
    assert cell.get_int("pendant.beep")
    assert any(text.startswith("Slowed to ") for text in texts)
    assert cell.get_string("pendant.text") == "Stopped: guard message too old, reset to go on"
    cell.set("command.guard.time", cell.time_us * 1e-6 + 1.0)  # of the future
    cell.set("command.reset", 1)
    cell.step(CYCLE_US, 5)
    assert cell.get_int("controller.error") == GUARD_TIMEOUT
    cell.set("command.guard.time", cell.time_us * 1e-6)
    cell.set("command.reset", 2)
    cell.step(CYCLE_US, 5)
    assert cell.get_int("controller.error") == 0
    assert cell.get_int("controller.moving")


@VERSIONS
def test_segment_waits_at_its_start_for_the_guard(build: Build, tmp_path: Path, version: int) -> None:
    """In view and without exposures, until a state is answered that shows its path; then it is only late."""
    cell = build(version, variants=["--ahead"])
    cell.set("command.guard.max_age", 0.4)
    cell.step(CYCLE_US, 2)
    begin = cell.time_us * 1e-6
    cell.set("command.guard.time", begin)
    cell.trigger(1, 0.1, exposure=2 * LEAD, segment=4)
    cell.set("command.trigger.to", 2.0)
    start(cell, write(tmp_path, program_data()))
    cell.step(CYCLE_US, 5)
    np.testing.assert_array_equal(cell.vector("measured.q", 6), START)
    assert cell.get_string("pendant.text") == "Waits for the guard"
    assert not cell.get_int("controller.moving")
    assert not cell.get_int("controller.at_destination")
    assert cell.get_int("trigger.count") == 0
    assert cell.get("controller.path_time", "controller.rate") == pytest.approx([begin, 0])
    assert cell.path_ahead()[31, 6] > 0.01
    for table in TURN * eased(TIMES / TIMES[-1])[1:]:
        cell.set("command.guard.time", cell.time_us * 1e-6)
        cell.step(CYCLE_US)
        assert cell.get("measured.table")[0] == pytest.approx(table, abs=1e-12)
    assert cell.get_int("trigger.count") == 21
    assert cell.get("controller.path_time")[0] == pytest.approx(begin)


def test_times_of_guard_and_path_count_from_the_start_time(build: Build, tmp_path: Path) -> None:
    cell = build()
    cell.slave.reset()
    cell.initialize(start_time=100.0)
    cell.set("command.guard.time", 100.016)
    for k in range(3):
        if k == 2:
            start(cell, write(tmp_path, program_data()))
        cell.slave.doStep(100 + k * CYCLE, CYCLE)
    assert cell.get("controller.guard.age", "controller.path_time") == pytest.approx([2 * CYCLE, 100 + 2 * CYCLE])


@pytest.mark.parametrize("begin", [-5.0, -0.1, 0.0, 5.0])
def test_guard_that_never_answers_starts_no_motion(build: Build, tmp_path: Path, begin: float) -> None:
    """`command.guard.time` keeps its start value 0, which a simulation that starts before it passes."""
    cell = build()
    cell.slave.reset()
    cell.initialize(start_time=begin)
    cell.set("command.guard.max_age", 20.0)
    start(cell, write(tmp_path, program_data()))
    for k in range(450):
        cell.slave.doStep(begin + k * CYCLE, CYCLE)
        if k % 50 == 49:
            assert not cell.get_int("controller.moving")
            assert cell.get("controller.guard.age")[0] == pytest.approx((k + 1) * CYCLE)


def test_pendant_shows_given_text_and_stops(build: Build) -> None:
    cell = build()
    cell.set("command.pendant.text", "wait for the part")
    cell.set("command.pendant.beep", 1)
    assert cell.get_string("pendant.text") == ""  # no output depends on an input without a step
    assert not cell.get_int("pendant.beep")
    cell.step(1)
    state = cell.serialize(cell.save())
    other = build()
    other.restore(other.deserialize(state), cell.time_us)
    assert other.get_string("pendant.text") == "wait for the part"
    cell.step(CYCLE_US)
    assert cell.get_string("pendant.text") == "wait for the part"
    assert cell.get_int("pendant.beep")
    cell.set("command.emergency_stop", 1)
    cell.step(CYCLE_US)
    assert cell.get_string("pendant.text") == "Emergency stop"
    cell.set("command.pendant.text", "stop: sensor - table: 5 mm")
    cell.step(CYCLE_US)
    assert cell.get_string("pendant.text") == "Emergency stop: sensor - table: 5 mm"


@VERSIONS
def test_path_ahead_matches_later_positions(build: Build, tmp_path: Path, version: int) -> None:
    cell = build(version, variants=["--ahead"])
    present = np.append(cell.vector("measured.q", 6), cell.get("measured.table"))
    np.testing.assert_array_equal(cell.path_ahead(), np.tile(present, (64, 1)))
    start(cell, write(tmp_path, program_data()))
    cell.step(CYCLE_US, 20)
    for point in cell.path_ahead():
        np.testing.assert_allclose(
            np.append(cell.vector("measured.q", 6), cell.get("measured.table")), point, atol=1e-10
        )
        cell.step(CYCLE_US)
