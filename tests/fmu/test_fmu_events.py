"""FMI 3: event mode with the clock of the trigger records, early return, intermediate update."""

from __future__ import annotations

import contextlib
import ctypes
import json
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from cell_fixture import (
    CYCLE_US,
    FREE,
    START,
    Build,
    CellFmu,
    FmuFolders,
    all_reals,
    cell_description,
    runtime_folder,
)
from test_fmu_sensing import collision_cell

LATENCY = 0.0004


def clock(cell: CellFmu) -> bool:
    """The clock has the reference after all variables, described or not."""
    return bool(cell.slave.getClock([len(cell.description.modelVariables)])[0])


def test_clock_is_described_only_on_request(tmp_path: Path) -> None:
    """Off by default: importers without support for clocks crash on its description."""
    file = tmp_path / "cell.json"
    file.write_text(json.dumps(cell_description()))
    command = [str(runtime_folder() / "robotcell-describe"), str(file), "--fmi", "3"]
    plain, clocked = (
        ET.fromstring(subprocess.run([*command, *more], check=True, capture_output=True, text=True).stdout)
        for more in ([], ["--clock"])
    )
    assert plain.find(".//Clock") is None
    found = clocked.find(".//Clock")
    assert found is not None
    assert found.attrib["intervalVariability"] == "triggered"
    assert int(found.attrib["valueReference"]) == len(plain.findall("ModelVariables/*"))
    outputs = [o.attrib["valueReference"] for o in clocked.findall("ModelStructure/Output")]
    assert outputs[-1] == found.attrib["valueReference"]
    initial = [o.attrib["valueReference"] for o in clocked.findall("ModelStructure/InitialUnknown")]
    clocks = {v.attrib["valueReference"] for v in clocked.findall("ModelVariables/*") if "clocks" in v.attrib}
    assert initial == [reference for reference in outputs[:-1] if reference not in clocks]
    ticking = {v.attrib["name"] for v in clocked.findall("ModelVariables/*") if "clocks" in v.attrib}
    records = {v.attrib["name"] for v in plain.findall("ModelVariables/*") if v.attrib["name"].startswith("trigger.")}
    assert ticking == records - {"trigger.count", "trigger.queued"}
    assert {v.attrib.get("clocks") for v in clocked.findall("ModelVariables/*") if v.attrib["name"] in ticking} == {
        found.attrib["valueReference"]
    }


def command_scan(cell: CellFmu) -> None:
    cell.command(START + 0.1, 2.0)
    cell.trigger(2, 0.01, exposure=0.0011)


class Event(NamedTuple):
    """Time and early return of an event, index and time of the current record, and colliding pairs."""

    time_us: int
    early: bool
    index: int
    record_time: float
    pairs: int


def run_events(
    cell: CellFmu, until_us: int, step_us: int, command: Callable[[CellFmu], None] = command_scan
) -> list[Event]:
    """Set inputs by `command`, step in event mode and return all events; the clock ticks with every record."""
    cell.slave.updateDiscreteStates()
    command(cell)
    cell.slave.enterStepMode()
    events: list[Event] = []
    collides = "truth.collision.pairs" in cell.variables
    while cell.time_us < until_us:
        size_us = min(step_us, until_us - cell.time_us)
        event, terminate, early, reached = cell.slave.doStep(cell.time_us * 1e-6, size_us * 1e-6)
        assert not terminate
        assert event or not early
        cell.time_us = round(reached * 1e6)
        if not event:
            continue
        cell.slave.enterEventMode()
        index, pairs = cell.get_int("trigger.index"), cell.get_int("truth.collision.pairs") if collides else 0
        assert clock(cell) == (index != (events[-1].index if events else 0))
        events.append(Event(cell.time_us, early, index, float(cell.get("trigger.time")[0]), pairs))
        assert not any(cell.slave.updateDiscreteStates()[:5])
        assert not clock(cell)
        cell.slave.enterStepMode()
    return events


@pytest.mark.parametrize("step_us", [CYCLE_US, 100_000])
def test_early_return_at_the_instant_of_each_record(build: Build, step_us: int) -> None:
    """Events are at mid-exposure plus latency, and the trajectory is bit-identical to plain stepping."""
    until_us = 40 * CYCLE_US
    parameters = {"as_built.trigger.latency": LATENCY}
    plain = build(3, FREE, parameters)
    command_scan(plain)
    while plain.time_us < until_us:
        plain.step(1000)
    cell = build(3, FREE, parameters, eventModeUsed=True, earlyReturnAllowed=True)
    events = run_events(cell, until_us, step_us)
    assert [event.index for event in events] == list(range(1, len(events) + 1))
    assert len(events) > 50
    for event in events:
        assert event.time_us == round((event.record_time + LATENCY) * 1e6)
        assert event.early or event.time_us % 1000 == 0
    # The current record differs, the cell itself does not.
    present = [n for n, v in cell.variables.items() if v.type == "Float64" and n.split(".")[0] in ("measured", "truth")]
    np.testing.assert_array_equal(cell.get(*present), plain.get(*present))


@pytest.mark.parametrize("intermediate", [False, True])
def test_events_are_the_same_at_every_communication_step(build: Build, intermediate: bool) -> None:
    """Records whose exposures end on controller cycles, and collisions, which begin and end there."""

    def command(cell: CellFmu) -> None:
        cell.command(table=6.0)
        cell.trigger(1, CYCLE_US / 2 * 1e-6)

    def events(step_us: int) -> list[tuple[int, int, int]]:
        cell = build_for_events(build, intermediate)
        return [(e.time_us, e.index, e.pairs) for e in run_events(cell, 50 * CYCLE_US, step_us, command)]

    expected = events(1000)
    assert [(time_us, index) for time_us, index, _ in expected[1:]] == [
        (k * CYCLE_US // 2, k + 1) for k in range(1, len(expected))
    ]
    assert len(expected) == 101
    assert {pairs for _, _, pairs in expected} == {0, 1}
    for step_us in (4000, CYCLE_US, 50_000, 7300):
        assert events(step_us) == expected, step_us


@pytest.mark.parametrize("intermediate", [False, True])
def test_begin_and_end_of_a_collision_are_events_at_controller_cycles(build: Build, intermediate: bool) -> None:
    cell = build_for_events(build, intermediate)
    events = run_events(cell, 2_000_000, 2_000_000, lambda cell: cell.command(table=3.0))
    assert [(event.pairs, event.early) for event in events] == [(1, True), (0, True)]
    assert all(event.time_us % CYCLE_US == 0 for event in events)


def build_for_events(build: Build, intermediate: bool) -> CellFmu:
    """A cell with a post in the path of its part, with or without intermediate updates."""
    watch = Intermediate()
    options = {"intermediateUpdate": watch} if intermediate else {}
    watch.cell = build(3, collision_cell(), eventModeUsed=True, earlyReturnAllowed=True, **options)
    return watch.cell


def test_event_is_reported_at_step_end_without_early_return(build: Build) -> None:
    cell = build(3, eventModeUsed=True)
    events = run_events(cell, 40 * CYCLE_US, CYCLE_US)
    assert len(events) > 20
    assert not any(event.early for event in events)
    assert all(event.time_us % CYCLE_US == 0 for event in events)


def test_no_events_without_event_mode(build: Build) -> None:
    cell = build(3, earlyReturnAllowed=True)
    command_scan(cell)
    flags = [cell.slave.doStep(k * 0.016, 0.016) for k in range(20)]
    assert cell.get_int("trigger.index") > 1
    assert not any(event or early for event, _, early, _ in flags)


@pytest.mark.parametrize(
    ("provoke", "expected"),
    [
        (lambda c: c.slave.doStep(0.0, 0.001), "in event mode"),
        (lambda c: c.slave.enterEventMode(), "in event mode"),
        (lambda c: (c.slave.enterStepMode(), c.set("command.table", 1.0)), "command.table is not allowed"),
        (lambda c: (c.slave.enterStepMode(), c.slave.enterStepMode()), "entering step mode"),
        (lambda c: (c.slave.enterStepMode(), c.slave.updateDiscreteStates()), "updating discrete states"),
        (lambda c: (c.slave.enterStepMode(), clock(c)), "reading a clock"),
        (lambda c: c.slave.getClock([1]), "not a clock"),
    ],
)
def test_calls_out_of_order_in_event_mode_are_errors(
    build: Build, provoke: Callable[[CellFmu], Any], expected: str
) -> None:
    cell = build(3, eventModeUsed=True)
    with pytest.raises(Exception, match="fmi3"):
        provoke(cell)
    assert expected in cell.messages[-1]
    cell.slave.reset()
    cell.initialize()
    cell.slave.enterStepMode()
    cell.step(1000)


def test_entering_event_mode_without_event_mode_used_is_an_error(build: Build) -> None:
    with pytest.raises(Exception, match="fmi3EnterEventMode"):
        build(3).slave.enterEventMode()


def test_state_contains_pending_event(build: Build) -> None:
    cell = build(3, FREE, eventModeUsed=True, earlyReturnAllowed=True)
    run_events(cell, 8 * CYCLE_US, CYCLE_US)  # the table still turns
    event, _, _, reached = cell.slave.doStep(cell.time_us * 1e-6, 0.016)
    cell.time_us = round(reached * 1e6)
    assert event
    state, time_us = cell.save(), cell.time_us
    other = build(3, FREE, eventModeUsed=True, earlyReturnAllowed=True)
    other.restore(other.deserialize(cell.serialize(state)), time_us)
    for instance in (cell, other):
        instance.slave.enterEventMode()
        assert clock(instance)
    np.testing.assert_array_equal(all_reals(cell), all_reals(other))
    in_event = cell.serialize(cell.save())
    plain = build(3, FREE)
    with pytest.raises(Exception, match="fmi3SetFMUState"):
        plain.restore(plain.deserialize(in_event), time_us)


class Intermediate:
    """Reads an output at every intermediate update, and requests an early return at one of them."""

    def __init__(self, stop_at: float = np.inf, stop_until: float = 0.0) -> None:
        self.cell: CellFmu | None = None
        self.seen: list[tuple[float, float, float]] = []
        self.stop_at, self.stop_until = stop_at, stop_until
        self.set_in_between = False

    def __call__(
        self, _env: Any, time: float, _set: bool, get: bool, finished: bool, _can: bool, requested: Any, until: Any
    ) -> None:
        assert self.cell is not None
        assert get
        assert finished
        if self.set_in_between:
            with contextlib.suppress(Exception):
                self.cell.set("command.table", 1.0)
        self.seen.append((time, *self.cell.get("time", "truth.table")))
        if time >= self.stop_at - 1e-9:
            ctypes.cast(requested, ctypes.POINTER(ctypes.c_bool))[0] = True
            ctypes.cast(until, ctypes.POINTER(ctypes.c_double))[0] = self.stop_until


def test_outputs_can_be_read_in_intermediate_update(build: Build) -> None:
    watch = Intermediate()
    watch.cell = build(3, intermediateUpdate=watch)
    watch.cell.command(table=2.0)
    _, _, early, reached = watch.cell.slave.doStep(0.0, 0.1)
    assert not early
    assert reached == 0.1
    plain = build(3)
    plain.command(table=2.0)
    expected = []
    for _ in range(6):
        plain.step(CYCLE_US)
        expected.append((plain.time_us * 1e-6, plain.time_us * 1e-6, plain.get("truth.table")[0]))
    np.testing.assert_allclose(watch.seen, expected, rtol=0, atol=1e-12)
    assert [row[2] for row in watch.seen] == [row[2] for row in expected]


@pytest.mark.parametrize(("until", "end"), [(0.0, 0.032), (0.032, 0.032), (0.05, 0.05), (9.0, 0.1)])
def test_importer_can_request_early_return(build: Build, until: float, end: float) -> None:
    watch = Intermediate(stop_at=0.032, stop_until=until)
    watch.cell = build(3, intermediateUpdate=watch, earlyReturnAllowed=True)
    watch.cell.command(table=2.0)
    _, _, early, reached = watch.cell.slave.doStep(0.0, 0.1)
    assert early == (end < 0.1)
    assert reached == pytest.approx(end, abs=1e-12)
    watch.cell.slave.doStep(reached, 0.004)


def test_early_return_request_is_ignored_where_not_allowed(build: Build) -> None:
    watch = Intermediate(stop_at=0.032)
    watch.cell = build(3, intermediateUpdate=watch)
    assert watch.cell.slave.doStep(0.0, 0.1)[2:] == (False, 0.1)


def test_setting_in_intermediate_update_is_an_error(build: Build) -> None:
    watch = Intermediate()
    watch.set_in_between = True
    watch.cell = build(3, intermediateUpdate=watch)
    with pytest.raises(Exception, match="fmi3DoStep"):
        watch.cell.slave.doStep(0.0, 0.1)
    assert any("during an intermediate update" in message for message in watch.cell.messages)
    watch.cell.slave.reset()
    watch.cell.initialize()


def test_only_continuous_outputs_have_intermediate_values(build: Build, folders: FmuFolders) -> None:
    cell = build(3)
    xml = ET.parse(folders.unpacked(3, cell_description()) / "modelDescription.xml")
    shown = {v.attrib["name"] for v in xml.findall("ModelVariables/*") if v.get("intermediateUpdate") == "true"}
    assert "truth.table" in shown
    assert shown == {n for n, v in cell.variables.items() if v.causality == "output" and v.variability == "continuous"}


class StatedVariables:
    """Reads variables at the first intermediate update; the importer stated one of them, or none."""

    def __init__(self, build: Build, stated: list[str], read: str) -> None:
        self.failed = False
        references = [build(3).variables[name].valueReference for name in stated]
        self.cell = build(3, intermediateUpdate=self.update, requiredIntermediateVariables=references)
        self.read = read
        with contextlib.suppress(Exception):
            self.cell.slave.doStep(0.0, 0.02)

    def update(self, *_arguments: Any) -> None:
        try:
            getter = self.cell.get_int if self.read == "controller.state" else self.cell.get
            getter(self.read)
        except Exception:
            self.failed = True


@pytest.mark.parametrize(
    ("stated", "read", "allowed"),
    [
        ([], "truth.table", True),
        ([], "time", True),
        ([], "controller.state", False),  # discrete
        (["truth.table"], "truth.table", True),
        (["truth.table"], "time", True),
        (["truth.table"], "truth.q[1]", False),
    ],
)
def test_importer_reads_intermediate_values_that_it_stated(
    build: Build, stated: list[str], read: str, allowed: bool
) -> None:
    run = StatedVariables(build, stated, read)
    assert run.failed != allowed
    assert (run.cell.messages == []) == allowed


@pytest.mark.parametrize("name", ["controller.state", "command.table"])
def test_variables_without_intermediate_values_cannot_be_required(build: Build, name: str) -> None:
    reference = build(3).variables[name].valueReference
    with pytest.raises(RuntimeError, match=f"{name} has no intermediate values"):
        build(3, requiredIntermediateVariables=[reference])
    with pytest.raises(RuntimeError, match="unknown value reference 99999"):
        build(3, requiredIntermediateVariables=[99999])
