"""`PYTHONPATH=tests python -m bench.api_fuzzer --calls 500`: wrong arguments to everything that scancell exports.

Half of the calls are valid but for one argument, in the others any argument may be wrong. A call may return or raise a
`ScancellError`. The table counts both, and any other exception, which is a defect. Work that takes long gets a progress
callback that cancels it.
"""

from __future__ import annotations

import argparse
import datetime
import faulthandler
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, chdir
from dataclasses import dataclass, field, fields
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import scancell
from scancell.calibration.cell.scan import CalibrationRequest
from scancell.calibration.sensor.report import SensorCalibrationRequest
from scancell.errors import CancelledError
from scancell.geometry.mesh import box_mesh

Arguments = dict[str, Any]


@dataclass(frozen=True)
class Target:
    """Something to call, by name, and valid arguments of it.

    Attributes
    ----------
    takes_long
        Whether a call takes more than a second unless its progress cancels; it always does.
    is_refused
        Whether even valid arguments are refused.
    """

    name: str
    call: Callable[..., Any]
    valid: Arguments
    takes_long: bool = False
    is_refused: bool = False

    @property
    def exported(self) -> str:
        """Name in ``scancell.__all__``."""
        return self.name.partition(".")[0]


@dataclass
class Outcome:
    """Counts of a target's calls, and those that raised what they must not, with their numbers."""

    name: str
    returned: int = 0
    refused: int = 0
    defects: list[str] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0


ABOVE = scancell.location(0.0, 0.0, 0.13, rx=np.pi)  # pose of the sensor over the part


class Fuzzer(AbstractContextManager["Fuzzer"]):
    """Targets that share a scanner, a scan and a folder, which is the current one meanwhile."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        try:
            self._enter()
        except BaseException:
            self._stack.close()  # the current folder is that of before
            raise

    def _enter(self) -> None:
        self.folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="scancell-fuzz-")))
        self._stack.enter_context(chdir(self.folder))
        pose = {"x_mm": 0.0, "y_mm": 0.0, "z_mm": 130.0, "rx_deg": 180.0}
        self.scan = scancell.ScanDescription(
            pose=[pose, {**pose, "x_mm": 1.0}], mode="stop-and-look", settle_ms=0, verify=False
        )
        self.part = box_mesh((0.03, 0.03, 0.02), "block")
        self.scanner = self._stack.enter_context(scancell.Scanner(scan=self.scan, threads=1))
        self.closed = scancell.Scanner(scan=self.scan)
        self.closed.close()
        self.plan = self.scanner.plan(self.part)
        self.result = self.scanner.scan(self.part, engine="geometric", plan=self.plan)
        self.exposure = self.scanner.shot(self.part, ABOVE)
        self.space = self.scanner.survey(self.part, radius=0.05, height=0.05, voxel=0.02, pitch=0.02)
        # Calls may write over what lies in the current folder: valid arguments are read from another one.
        for folder in ("inputs", "."):
            self._write_files(Path(folder))
        self.targets = [
            *self._descriptions(),
            *self._data(),
            *self._scanner_calls(),
            *self._functions(),
            *self._running_cell(),
            *self._live_cell(),
        ]

    def _write_files(self, folder: Path) -> None:
        self.result.save(folder / "run")
        self.exposure.save(folder / "shot")
        (folder / "part.obj").write_text(_TETRAHEDRON)
        (folder / "study.toml").write_text(_STUDY)
        (folder / "points.csv").write_text("x_mm,y_mm,z_mm\n")

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def run(self, target: Target, calls: int, seed: int) -> Outcome:
        """Call a target with valid arguments, then with random ones."""
        outcome = Outcome(target.name)
        try:
            target.call(**target.valid)
        except CancelledError:
            assert target.takes_long, target.name
        except scancell.ScancellError as error:
            assert target.is_refused, f"{target.name}: {error}"
        for number in range(calls):
            self.call(target, number, seed, outcome)
        return outcome

    def call(self, target: Target, number: int, seed: int, outcome: Outcome) -> None:
        """Make one call and count it; the same number and seed make the same call."""
        rng = np.random.default_rng([seed, *target.name.encode(), number])
        given, start = self._arguments(target, number, rng), time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                target.call(**given)
        except scancell.ScancellError as error:
            outcome.refused += 1
            outcome.kinds[type(error).__name__] += 1
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__}: {error}"[:200]
            shown = ", ".join(f"{key}={value!r:.80}" for key, value in given.items() if value is not target.valid[key])
            outcome.defects.append(f"call {number}: {shown}\n    {what} ({Path(where.filename).name}:{where.lineno})")
        else:
            outcome.returned += 1
        outcome.slowest = max(outcome.slowest, time.perf_counter() - start)

    def _arguments(self, target: Target, number: int, rng: np.random.Generator) -> Arguments:
        names = list(target.valid)
        one = [names[rng.integers(len(names))]] if names else []
        wrong = one if number % 2 == 0 else [name for name in names if rng.random() < 0.3]
        return {name: self._odd(target, name, rng) if name in wrong else target.valid[name] for name in names}

    def _odd(self, target: Target, name: str, rng: np.random.Generator) -> Any:
        """Another value for an argument: of any type, or like the valid one."""
        values = _like(target.valid[name]) if rng.random() < 0.4 else []
        values = values or self._values()
        value = values[rng.integers(len(values))]
        return cancels if value is None and name == "progress" and target.takes_long else value

    def _values(self) -> list[Any]:
        """Values that an argument may be given; new ones each time, because a call may change them."""
        plain = [None, True, False, 0, -1, 1, 3, 2**31, 10**400, 0.0, 0.5, -1.5, 1e300, np.nan, np.inf, 1j]
        numpy = [
            *(np.float32(0.5), np.float64(np.nan), np.float16(2), np.int64(2), np.uint8(1), np.bool_(True)),
            *(np.str_("mm"), np.datetime64("2020-01-01"), np.array(0.5), np.array(3), np.array("text")),
            *(np.zeros(0), np.zeros(3), np.zeros((0, 3)), np.zeros((4, 2)), np.zeros((2, 3)), np.ones((2, 3), int)),
            *(np.full((2, 3), np.nan), np.eye(4), np.array([None, 1], object), np.zeros(6), np.zeros((2, 3), complex)),
        ]
        text = [
            *("", "x", "mm", "geometric", "a\0b", "ä" * 300),
            *("no/such.stl", "part.obj", "run", "points.csv", "study.toml"),
        ]
        paths = [Path("part.obj"), Path(), Path("missing"), b"part.obj", Path("run/cloud.ply"), Path("study.toml/x")]
        collections = [
            *([], {}, (), set(), [1, 2], [1, "a"], [None], ["x"], [[1], [2, 3]], range(3), iter([1]), {"a": 1}, {1: 2}),
            *([("tool.x_mm", 0.1)], {"tool.x_mm": 0.1}, {"tool.x_mm": np.float32(0.1)}, {"tool.x_mm": "far"}),
            *(["tool.x_mm=0.1"], ["tool.x_mm"], ["=1"], {"": 1}, {"sensor.laser.turn_y_deg": 0.1}, {"sensor": 1}),
            *({"cell.part.x_mm": np.int64(1)}, {"cell.part.x_mm": np.nan}, {"cell[1].a": 1}),
            *([1.0, 2.0, 130.0, 180.0, 0.0, 0.0], ["part.obj"], ["shot"], {"scan.max_profiles": [1]}, [0]),
        ]
        objects = [
            *(object(), ..., cancels, ValueError("x"), Decimal(1), Fraction(1, 3), datetime.date(2020, 1, 1)),
            *(self.part, self.result.cloud, self.plan, self.scan, self.scanner.setup, self.closed, self.result),
            *(self.exposure, self.space, box_mesh((1e-6, 1e-6, 1e-6)), self.scanner.setup.sensor),
        ]
        return [*plain, *numpy, *text, *paths, *collections, *objects]

    def _descriptions(self) -> list[Target]:
        setup = self.scanner.setup
        made = []
        for one in (setup.cell, setup.sensor, setup.scan):
            name, kind = type(one).__name__, type(one)
            one.to_toml(f"inputs/{name}.toml")
            made += [
                Target(name, kind, dict(one)),
                Target(f"{name}.replace", lambda changes, one=one: one.replace(changes), {"changes": {}}),
                Target(f"{name}.from_toml", kind.from_toml, {"path": f"inputs/{name}.toml"}),
                Target(f"{name}.to_toml", one.to_toml, {"path": "out.toml"}),
            ]
        return [*made, Target("Setup", scancell.Setup, vars(setup).copy())]

    def _data(self) -> list[Target]:
        cloud, result = self.result.cloud, self.result
        return [
            Target("Cloud", scancell.Cloud, _fields(cloud)),
            Target("Cloud.concatenate", scancell.Cloud.concatenate, {"clouds": [cloud, cloud]}),
            Target("Mesh", scancell.Mesh, _fields(self.part)),
            Target("Mesh.transformed", self.part.transformed, {"target_from_part": np.eye(4)}),
            Target("Plan", scancell.Plan, _fields(self.plan)),
            Target("Plan.save", self.plan.save, {"path": "plan.json"}),
            Target("Cloud.save", cloud.save, {"path": "cloud.ply"}),
            Target("Cloud.load", scancell.Cloud.load, {"path": "inputs/run/cloud.ply"}),
            Target("Coverage", scancell.Coverage, _fields(result.coverage)),
            Target("Deviation", scancell.Deviation, _fields(result.deviation)),
            Target("Recording", scancell.Recording, _fields(result.recording)),
            Target("Recording.save", result.recording.save, {"path": "recording.csv"}),
            Target("Recording.joined", scancell.Recording.joined, {"parts": [result.recording, result.recording]}),
            Target("Recording.truth_at_middle", result.recording.truth_at_middle, {"frame": "sensor"}),
            Target("ScanResult", scancell.ScanResult, _fields(result)),
            Target("ScanResult.save", result.save, {"folder": "saved", "formats": ["ply"], "frame": "part"}),
            Target("ScanResult.evaluate", result.evaluate, {"progress": cancels}, takes_long=True),
            Target("ScanResult.coverage_of", result.coverage_of, {"samples": 100, "surface": None}),
            Target("ScanResult.points_in", result.points_in, {"frame": "world", "table_angle": 0.5}),
            Target("ScancellError", scancell.ScancellError, {}),
            Target("ShotResult", scancell.ShotResult, _fields(self.exposure)),
            Target("ShotResult.save", self.exposure.save, {"folder": "saved"}),
            Target("SurveyResult", scancell.SurveyResult, _fields(self.space)),
            Target("SurveyResult.save", self.space.save, {"path": "saved.npz"}),
        ]

    def _scanner_calls(self) -> list[Target]:
        scanner, part = self.scanner, self.part
        built: Arguments = {"as_built": {"tool.x_mm": 0.1}, "seed": 1}
        of_sensor: Arguments = {"as_built": {"sensor.laser.turn_y_deg": 0.1}, "seed": 1}
        estimated: Arguments = {"estimated": None, "estimated_sensor": None}
        setup = {"cell": None, "sensor": None, "scan": self.scan, "settings": {}, "ideal": True, "threads": 1}
        scan = {"part": part, "unit": "mm", "engine": "geometric", **built, **estimated, "plan": self.plan}
        scan |= {"setup": None, "normals": True, "samples": True, "on_images": None, "hook": None, "progress": None}
        survey = {"part": part, "unit": "mm", "radius": 0.05, "height": 0.05, "voxel": 0.02, "pitch": 0.02}
        survey |= {"inflation": 0.002, **built, "progress": cancels}
        calibrate = {"request": "tool", "artefact": None, "unit": "mm", "engine": "geometric", **built}
        calibrate |= {"setup": None, "from_points": None, "flange": None, "convention": None, "progress": cancels}
        calibrate |= {"table_format": None}
        of_part: Arguments = {"part": part, "unit": "mm", "engine": "geometric", **of_sensor}
        render = {"recording": "inputs/run/recording.parquet", **of_part, **estimated}
        plan = {"part": part, "unit": "mm", "setup": None, "quality_factors": (), "progress": None}
        place = {"part": part, "share": 0.9, "unit": "mm", "progress": cancels}
        sensor = {"request": "ball", **of_sensor, "progress": cancels}
        shot = {**of_part, "part_from_sensor": ABOVE}
        return [
            Target("Scanner", scancell.Scanner, {**setup, "setup": None}),
            Target("Scanner.load_part", scanner.load_part, {"part": "inputs/part.obj", "unit": "mm"}),
            Target("Scanner.scan", scanner.scan, scan),
            Target("Scanner.scan closed", self.closed.scan, scan, is_refused=True),
            Target("Scanner.render", scanner.render, {**render, **estimated, "on_images": None, "progress": None}),
            Target("Scanner.plan", scanner.plan, plan),
            Target("Scanner.survey", scanner.survey, survey, takes_long=True),
            Target("Scanner.place", scanner.place, place, takes_long=True),
            Target("Scanner.session", self._session, {"part": part, "unit": "mm", **built, "guarded": False}),
            Target("Scanner.shot", scanner.shot, shot),
            Target("Scanner.calibrate", scanner.calibrate, calibrate, takes_long=True),
            Target("Scanner.calibrate_sensor", scanner.calibrate_sensor, sensor, takes_long=True),
            Target("CalibrationRequest", CalibrationRequest, _fields(CalibrationRequest())),
            Target("SensorCalibrationRequest", SensorCalibrationRequest, _fields(SensorCalibrationRequest())),
        ]

    def _session(self, **arguments: Any) -> None:
        with self.scanner.session(**arguments):
            pass

    def _temporary_fmu(self, **arguments: Any) -> None:
        made = scancell.make_temporary_fmu(**arguments)
        if made.resolve() != Path.cwd():  # which holds the inputs of all calls
            shutil.rmtree(made, ignore_errors=True)

    def _running_cell(self) -> list[Target]:
        """Names that read and build things, and those of the running cell and its guard."""
        setup, part = self.scanner.setup, self.part
        nominal = scancell.nominal_cell(setup.cell, part)
        described = scancell.cell_json(setup.cell, nominal, 0)
        instance = self._stack.enter_context(scancell.CellInstance(scancell.make_temporary_fmu(described, Path("fmu"))))
        session = self._stack.enter_context(self.scanner.session(part))
        guard = scancell.guard_of(setup.cell, part)
        link = scancell.Link(scancell.InProcess(guard), 0.1)
        cycle_us = setup.cell.world.controller_cycle_us
        files: Arguments = {"unit": "mm"}
        axes = np.append(nominal.home, 0.0)
        state = scancell.CellState(1, 0.0, scancell.Operation.MANUAL, scancell.Mode.HOLD, False, axes)
        at_flange = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        faulty: Arguments = {"transport": scancell.InProcess(guard), "description": scancell.LinkDescription()}
        faulty |= {"age_limit": 0.1, "seed": 1}

        def serve_guard(**given: Any) -> None:
            scancell.serve_guard(**given, started=lambda _host, _port: signal.raise_signal(signal.SIGTERM))

        def build_fmu(**given: Any) -> None:
            scancell.build_fmu(described, "cell.fmu", **given)

        address: Arguments = {"host": "127.0.0.1", "port": 9}
        return [
            Target("assets_dir", scancell.assets_dir, {}),
            Target("box_mesh", scancell.box_mesh, {"size": (0.1, 0.1, 0.1), "source": "box"}),
            Target("location", scancell.location, {"x": 0.1, "y": 0.0, "z": 0.2, "rx": 0.1, "ry": 0.0, "rz": 0.0}),
            Target("load_part", scancell.load_part, {"path": "inputs/part.obj", **files}),
            Target("load_artefact", scancell.load_artefact, {"path": scancell.assets_dir() / "artefacts/sphere.toml"}),
            Target(
                "load_setup",
                scancell.load_setup,
                {"cell": None, "sensor": None, "scan": self.scan, "settings": {}, "ideal": False},
            ),
            Target("read_recording", scancell.read_recording, {"path": Path("inputs/run/recording.parquet")}),
            Target("nominal_cell", scancell.nominal_cell, {"cell": setup.cell, "part": part}),
            Target("cell_json", scancell.cell_json, {"cell": setup.cell, "nominal": nominal, "seed": 0}),
            Target("build_fmu", scancell.build_fmu, {"description": described, "path": Path("cell.fmu"), "version": 2}),
            Target(
                "make_temporary_fmu",
                self._temporary_fmu,
                {"description": described, "folder": Path("unpacked")},
            ),
            Target("guard_of", scancell.guard_of, {"cell": setup.cell, "part": part, "scan": None, **files}),
            Target("GuardSettings", scancell.GuardSettings, _fields(guard.settings)),
            Target("Guard", scancell.Guard, {"nominal": nominal, "robot": setup.cell.robot, "settings": None}),
            Target("InProcess", scancell.InProcess, {"answerer": guard, "compute_time": 0.004}),
            Target("Link", scancell.Link, {"transport": scancell.InProcess(guard), "age_limit": 0.1}),
            Target("UdpTransport", lambda **given: scancell.UdpTransport(**given).close(), address),
            Target("TcpTransport", lambda **given: scancell.TcpTransport(**given).close(), address, is_refused=True),
            Target(
                "GuardedCell",
                scancell.GuardedCell,
                {"cell": instance, "cycle_us": cycle_us, "link": link, "max_age": 0.1},
            ),
            Target("CellInstance", lambda fmu: scancell.CellInstance(fmu).close(), {"fmu": Path("fmu").absolute()}),
            Target("CellSession", scancell.CellSession, {"cell": instance, "nominal": nominal, "cycle_us": cycle_us}),
            Target(
                "ScanSession",
                scancell.ScanSession,
                {"instance": instance, "world": session.world, "pipeline": session.pipeline, "guard": None},
            ),
            Target("SignalLog", scancell.SignalLog, {"cell": instance, "reals": ["measured.table"], "booleans": ()}),
            Target("Robot", scancell.Robot, {"session": session, "engine": "geometric", "folder": Path()}),
            Target("ChannelDescription", scancell.ChannelDescription, dict(scancell.ChannelDescription())),
            Target("LinkDescription", scancell.LinkDescription, dict(scancell.LinkDescription())),
            Target("faulty_link", scancell.faulty_link, faulty),
            Target("serve_guard", serve_guard, {"answerer": guard, "host": "127.0.0.1", "port": 0, "protocol": "udp"}),
            Target("CellState", scancell.CellState, _fields(state)),
            Target("GuardMessage", scancell.GuardMessage, _fields(guard.answer(state))),
            Target(
                "PlacedPart",
                scancell.PlacedPart,
                {"number": 1, "carrier": 6, "pose": at_flange},
            ),
            Target("PartTracker", scancell.PartTracker, {"cell": setup.cell, "nominal": nominal}),
            Target("FmuOptions", scancell.FmuOptions, _fields(scancell.FmuOptions())),
            Target("build_fmu.options", build_fmu, {"version": 3, "options": scancell.FmuOptions()}),
        ]

    def _live_cell(self) -> list[Target]:
        """A cell that is commanded while it runs; here nothing steps it."""
        cell = self._stack.enter_context(self.scanner.session(self.part))
        live = scancell.LiveCell(cell)
        of_cell: Arguments = {"live": live, "session": cell}
        pose: Arguments = {"world_from_tool": ABOVE, "tool": "sensor", "speed": 0.5}
        view: Arguments = {"view": "part", "size": (64, 64), "colour": "intensity", "threads": 1}
        recorder = self._stack.enter_context(scancell.SessionRecorder("recorded.mcap", cell.true))
        plan = scancell.LivePlan(**of_cell)
        self.scanner.scan("inputs/part.obj", engine="geometric").save("inputs/of_file")
        other = self._stack.enter_context(self.scanner.session(self.part))
        (self.folder / "inputs" / "turn.py").write_text("def main(robot): robot.turn_table(0.1)")
        return [
            Target("LiveCell", scancell.LiveCell, {"session": cell, "hold_time": 0.3, "state_cycles": 1}),
            Target("JogJoints", scancell.JogJoints, {"deflections": [0.1, 0.2]}),
            Target("JogSensor", scancell.JogSensor, {"deflections": [0.1] * 6, "frame": scancell.JogFrame.SENSOR}),
            Target("MoveJoints", scancell.MoveJoints, {"joints": cell.home, "table_angle": 0.1, "speed": 0.5}),
            Target("MoveAxis", scancell.MoveAxis, {"name": "track", "position": 0.1, "speed": 0.5}),
            Target("MoveTool", scancell.MoveTool, pose),
            Target("MoveLine", scancell.MoveLine, pose),
            Target("SetMonitorSpeed", scancell.SetMonitorSpeed, {"share": 0.5}),
            Target("SetOperation", scancell.SetOperation, {"operation": scancell.Operation.MANUAL}),
            Target("Cancel", scancell.Cancel, {}),
            Target("Reset", scancell.Reset, {}),
            Target("OpenGripper", scancell.OpenGripper, {"width": 0.02}),
            Target("CloseGripper", scancell.CloseGripper, {"force": 10.0}),
            Target("RunConveyor", scancell.RunConveyor, {"conveyor": 1, "speed": 0.1}),
            Target("JobStopped", scancell.JobStopped, {"why": "stopped"}),
            Target("LiveScan", scancell.LiveScan, {"engine": "geometric", "plan": None, "batch": 16, "most_behind": 8}),
            Target("LivePlan", scancell.LivePlan, {**of_cell, "has_part": True}),
            Target("LivePlan.go_to", plan.go_to, {"axes": np.zeros(7), "purpose": "the start"}),
            Target("LivePlan.map_of", plan.map_of, {"path": 0, "branch": 0}),
            Target("LivePlan.evaluate", plan.evaluate, {"path": 0, "branch": 0}, is_refused=True),
            Target("LivePlan.judge", plan.judge, {"path": 0, "branch": 0, "share": 0.5, "angle": 1.0}, is_refused=True),
            Target(
                "CameraFeed",
                lambda **given: scancell.CameraFeed(**given).close(),
                {**of_cell, "engine": "geometric"},
            ),
            Target(
                "SessionRecorder",
                lambda **given: scancell.SessionRecorder(**given).close(),
                {"path": "session.mcap", "cell": cell.true},
            ),
            Target("SessionRecorder.state", recorder.state, {"state": live.state}),
            Target(
                "run_program",
                scancell.run_program,
                {"program": "inputs/turn.py", "session": other, "engine": "geometric", "folder": "written"},
            ),
            Target("picture", scancell.picture, {"run": "inputs/of_file", "out": "picture.png", "time": None, **view}),
            Target(
                "animate",
                scancell.animate,
                {"run": "inputs/of_file", "out": "run.webp", "fps": 5, "seconds": 0.2, **view, "progress": cancels},
                takes_long=True,
            ),
        ]

    def _functions(self) -> list[Target]:
        part, sensor = self.part, self.scanner.setup.sensor
        cell: Arguments = {"cell": None, "sensor": sensor, "scan": self.scan, "settings": {}}
        run: Arguments = {"ideal": True, "threads": 1}
        built: Arguments = {"as_built": {}, "seed": 1}
        of_part: Arguments = {"part": part, "unit": "mm"}
        no_scan = {name: value for name, value in cell.items() if name != "scan"}
        of_acceptance = {"quick": True, "repeats": 1, "factors": None, "limits": (), "out": None, "threads": 1}
        of_batch = {"parts": ["inputs/part.obj"], "out": "batch", "config": None}
        of_batch |= {"variants": 1, "workers": 1, "seed": 1}
        of_sensor = {"request": "ball", "sensor": sensor, "settings": {}}
        images = {"folder": "inputs/shot", "board": "7x6x10", "sensor": sensor, "settings": {}, "convention": None}
        images |= {"threads": 1, "progress": None}
        compare = {
            "run": "inputs/shot",
            "part": None,
            "unit": "mm",
            "out": None,
            "seed": 0,
            "threads": 1,
            "progress": None,
        }
        reconstruct = {"data": "inputs/shot", "calibration": None, "flange": None, "laser_off": None, **images}
        reconstruct |= {"part": None, "unit": "mm", "cell": None, "quarter_turns": 0, "latency_ms": 1.0}
        reconstruct |= {"keep_all": False}
        del reconstruct["folder"], reconstruct["board"]
        evaluate = {"cloud": self.result.cloud, "mesh": part, "artefact": None, "align": "none", "datum": ()}
        extract = {"images": ["inputs/shot"], "out": "extracted", "sensor": sensor, "settings": {}, "laser_off": ()}
        geometric: Arguments = {"engine": "geometric"}
        calibrate = {"request": "tool", "artefact": None, **cell, **run, **built}
        render = {"recording": "inputs/run/recording.parquet", **of_part, **no_scan, **run, **geometric}
        shot = {**of_part, "part_from_sensor": ABOVE, **no_scan, **run, **geometric}
        study = {"file": "inputs/study.toml", "out": "study", "settings": {}, "workers": 1}
        survey = {**of_part, **cell, **run, "radius": 0.05, "voxel": 0.02}
        short = [
            Target("evaluate", scancell.evaluate, {**evaluate, "out": None, "unit": "mm", "threads": 1}),
            Target("extract", scancell.extract, {**extract, "sheet_um": None, "peaks": False, "threads": 1}),
            Target(
                "mesh", scancell.mesh, {"run": "inputs/run", "out": None, "method": "ball-pivoting", "spacing_mm": 1.0}
            ),
            Target("plan", scancell.plan, {**of_part, **cell, "progress": None}),
            Target("render", scancell.render, render),
            Target("scan", scancell.scan, {**of_part, **cell, **run, **built, **geometric, "plan": self.plan}),
            Target("shot", scancell.shot, shot),
            Target("calibrate_from_images", scancell.calibrate_from_images, images, is_refused=True),
            Target("reconstruct", scancell.reconstruct, reconstruct, is_refused=True),
            Target("compare", scancell.compare, compare, is_refused=True),
        ]
        long = [
            Target("acceptance", scancell.acceptance, {**cell, **built, **geometric, **of_acceptance}),
            Target("batch", scancell.batch, {**of_batch, **geometric}),
            Target("calibrate", scancell.calibrate, calibrate),
            Target("calibrate_sensor", scancell.calibrate_sensor, {**of_sensor, **run}),
            Target("place", scancell.place, {**of_part, "share": 0.9, **cell}),
            Target("study", scancell.study, study),
            Target("survey", scancell.survey, survey),
        ]
        return [*short, *(Target(one.name, one.call, {**one.valid, "progress": cancels}, True) for one in long)]


_TETRAHEDRON = "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
_STUDY = """
name = "fuzz"
part = "part.obj"
engine = "geometric"
[design]
kind = "monte_carlo"
trials = 1
[[factor]]
path = "as_built.tool.x_mm"
distribution = { kind = "uniform", low = 0.0, high = 0.1 }
"""


def _like(valid: Any) -> list[Any]:  # noqa: PLR0911
    """Values of the type of a valid one, or of NumPy's, right and wrong."""
    if isinstance(valid, bool):
        return [np.bool_(valid), np.array(valid), not valid]
    if isinstance(valid, Enum):
        return [int(valid), valid.name, np.int64(valid), type(valid)]
    if isinstance(valid, int | float):
        kind = np.int64 if isinstance(valid, int) else np.float32
        return [kind(valid), np.array(valid), -valid, 2 * valid, type(valid)(1e-3 * valid), 10**6 * valid]
    if isinstance(valid, str):
        return [np.str_(valid), Path(valid), valid.upper(), valid + " ", valid[:-1]]
    if isinstance(valid, dict):
        numbers = {key: np.float64(0.01) for key in valid}
        return [numbers, dict.fromkeys(valid, "x"), [f"{key}=0.01" for key in valid], {**valid, "x": 1}]
    if isinstance(valid, np.ndarray):
        changed = [valid.astype(np.float32), valid[:-1], valid[::-1], np.full(valid.shape, np.nan), valid.T]
        return [valid.tolist(), *changed]
    if isinstance(valid, list | tuple):
        return [tuple(valid), list(valid), valid[:-1], [*valid, *valid], [*valid, None]]
    return []


def cancels(*_: object) -> bool:
    """A progress callback that cancels."""
    return False


def _fields(data: Any) -> Arguments:
    return {one.name: getattr(data, one.name) for one in fields(data) if one.init}


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=500, help="calls of each target")
    parser.add_argument("--seed", type=int, default=0, help="random seed")
    parser.add_argument("--only", nargs="*", default=(), help="targets whose names begin with one of these")
    parser.add_argument("--call", type=int, help="only the call of this number, with its traceback")
    given = parser.parse_args()
    faulthandler.enable()
    total: Counter[str] = Counter()
    with Fuzzer() as fuzzer:
        print(f"{'target':<46}{'calls':>7}{'returned':>10}{'refused':>9}{'defects':>9}{'slowest s':>11}")
        for target in fuzzer.targets:
            if given.only and not target.name.startswith(tuple(given.only)):
                continue
            outcome = Outcome(target.name)
            if given.call is not None:
                fuzzer.call(target, given.call, given.seed, outcome)
            else:
                outcome = fuzzer.run(target, given.calls, given.seed)
            total.update(calls=outcome.returned + outcome.refused + len(outcome.defects), defects=len(outcome.defects))
            counts = f"{outcome.returned:>10}{outcome.refused:>9}{len(outcome.defects):>9}{outcome.slowest:>11.2f}"
            print(f"{target.name:<46}{given.calls:>7}{counts}", flush=True)
            for defect in outcome.defects[:8]:
                print(f"  {defect}", flush=True)
    print(f"{total['calls']} calls, {total['defects']} defects")
    raise SystemExit(bool(total["defects"]))


if __name__ == "__main__":
    main()
