"""Test cell description, FMUs packed from it, and a driver for both FMI versions."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import threading
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

import scancell.cell
from scancell.cell.fmu_file import mesh_json

Array = NDArray[np.float64]
LIMITS_DEG = [(-170, 170), (-190, 45), (-29, 256), (-190, 190), (-120, 120), (-360, 360)]
DH_MM_DEG = [(75, 335, -90), (270, 0, 0), (-90, 0, 90), (0, 295, -90), (0, 0, 90), (0, 80, 0)]
START_DEG = [35, -25, 195, -68, 79, -10]
START = np.radians(START_DEG)
CYCLE_US = 16000
MOTION = {
    "line_speed": 1.0, "line_acceleration": 5.0, "turn_speed": 3.0, "turn_acceleration": 12.0,
    "jog_speed": 0.25, "jog_acceleration": 0.8, "jog_turn_speed": 0.8, "jog_turn_acceleration": 3.0,
    "jog_joint_share": 0.1,
}  # fmt: skip
Parameters = Mapping[str, float | int | str]
BODIES = [*(f"link[{i}]" for i in range(1, 7)), "sensor", "table", "part[1]"]


def pose(position: Sequence[float], quaternion: Sequence[float] = (1, 0, 0, 0)) -> dict[str, list[float]]:
    return {"position": list(position), "quaternion": list(quaternion)}


def box_hull(x: float, y: float, z: float, base: float = 0.0) -> dict[str, Any]:
    """Hull of a box with its base at a height, centred on the z axis."""
    vertices = [[sx * x / 2, sy * y / 2, base + h] for h in (0.0, z) for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    quads = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return mesh_json(vertices, [f for a, b, c, d in quads for f in ([a, b, c], [a, c, d])])


def box_part(x: float, y: float, z: float, mass: float = 0.5, **part: Any) -> dict[str, Any]:
    """Description of a box clamped on the table, 20 mm off its axis; keyword arguments override keys."""
    inertia = np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2]) * mass / 12
    return {
        "name": "box", "fixture": "clamped", "stands_on": "table", "support_from_part": pose([0.02, 0, 0]),
        "friction": 0.5, "soft": None, "hull": box_hull(x, y, z),
        "inertial": {"mass": mass, "centre_of_mass": [0, 0, z / 2], "inertia": inertia.tolist()}, **part,
    }  # fmt: skip


def conveyor(**changes: Any) -> dict[str, Any]:
    """Description of a belt of 1.2 m along the world's x axis; keyword arguments override keys."""
    return {
        "name": "belt", "world_from_belt": pose([0, -1, 0.2]), "length": 1.2, "width": 0.3, "thickness": 0.05,
        "max_speed": 1.0, "max_acceleration": 2.0, "friction": 0.5, "encoder_resolution": 0.0, **changes,
    }  # fmt: skip


def collision(*pairs: tuple[str, str], **changes: Any) -> dict[str, Any]:
    """Description of collision outputs for pairs of bodies; keyword arguments override keys."""
    watched = [list(pair) for pair in pairs]
    return {"outputs": True, "stops_arm": False, "swept": True, "range": 0.05, "pairs": watched, **changes}


def cell_description(**part: Any) -> dict[str, Any]:
    """Default arm, table and a box, with ideal encoders; keyword arguments override keys of the box."""
    joints = [
        {
            "a": a / 1000, "d": d / 1000, "alpha": np.radians(alpha), "theta": 0.0,
            "min": np.radians(low), "max": np.radians(high), "max_speed": 5.0, "max_acceleration": 20.0,
            "max_jerk": 400.0, "start": np.radians(start),
            "encoder_resolution": 0.0, "encoder_noise": 0.0, "encoder_latency": 0.0,
        }
        for (a, d, alpha), (low, high), start in zip(DH_MM_DEG, LIMITS_DEG, START_DEG, strict=True)
    ]  # fmt: skip
    return {
        "format": 2, "name": "test cell", "time_step_us": 1000, "controller_cycle_us": 16000,
        "gravity": [0.0, 0.0, -9.80665], "seed": 0,
        "robot": {
            "world_from_base": pose([0, 0, 0]), "joints": joints, "held_joints": [],
            "motion": MOTION, "dynamics": None,
        },
        "tool": {"flange_from_sensor": pose([0.01, -0.02, 0.08], [0.5, 0.5, 0.5, 0.5])},
        "table": {
            "world_from_table": pose([0.45, 0, 0.1]), "radius": 0.12, "thickness": 0.02, "max_speed": 10.0,
            "max_acceleration": 20.0, "max_jerk": 400.0, "start": 0.0, "friction": 0.5,
            "encoder_resolution": 0.0, "encoder_noise": 0.0, "encoder_latency": 0.0,
        },
        "conveyors": [],
        "parts": [{**box_part(0.06, 0.04, 0.05), **part}],
        "gripper": None,
        "contact": {
            "solver": "dantzig", "points": 4, "stick": True, "friction": 0.3, "bodies": [], "pairs": [],
        },
        "bodies": [], "presence_sensors": [], "distance_sensors": [],
        "collision": collision(outputs=False),
    }  # fmt: skip


FREE = cell_description(fixture="free", support_from_part=pose([0.06, 0.02, 0]))


def further_axis(name: str, slides: bool, most: float, **changes: Any) -> dict[str, Any]:
    """Description of an axis of the world along or about z, from -most to most; keyword arguments override keys."""
    return {
        "name": name, "slides": slides, "moves_with": "world", "parent_from_joint": pose([0, 0, 0]),
        "joint_from_frame": pose([0, 0, 0]), "min": -most, "max": most, "max_speed": 0.5, "max_acceleration": 1.5,
        "max_jerk": 30.0, "start": 0.0, "encoder_resolution": 0.0, "encoder_noise": 0.0,
        "encoder_latency": 0.0, **changes,
    }  # fmt: skip


# A free part on a table that a lift moves, and an arm on a column that turns on a track along y.
_ALONG_Y = [np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]
AXES = {
    **FREE,
    "axes": [
        further_axis(
            "track", True, 0.6, parent_from_joint=pose([0.02, -0.1, 0.05], _ALONG_Y), start=0.1,
            joint_from_frame=pose([0, 0, 0], [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]), encoder_resolution=1e-6,
            encoder_latency=0.002,
        ),
        further_axis("column", False, 1.0, moves_with="axis[1]", encoder_noise=1e-6),
        further_axis("lift", True, 0.15, max_speed=0.1, max_acceleration=0.5),
    ],
    "robot": {**FREE["robot"], "moves_with": "axis[2]"},
    "table": {**FREE["table"], "moves_with": "axis[3]"},
}  # fmt: skip


def runtime_folder() -> Path:
    """Folder of the native runtime: of the build folder named in the environment, or of the installed package."""
    named = os.environ.get("SCANCELL_FMU_RUNTIME")
    folders = [Path(named)] if named else [Path(p) / "runtime" for p in scancell.cell.__path__]
    for folder in folders:
        if (folder / "RobotCell.so").is_file():
            return folder
    raise FileNotFoundError(f"no native runtime in {folders}: build and install the project")


def write_fmu(cell: dict[str, Any], version: int, folder: Path, *variants: str) -> Path:
    """Write the unpacked files of an FMU for a cell description; `variants` are options of robotcell-describe."""
    runtime, text = runtime_folder(), json.dumps(cell)
    command = [str(runtime / "robotcell-describe"), "-", "--fmi", str(version), *variants]
    xml = subprocess.run(command, input=text.encode(), check=True, capture_output=True).stdout
    resources, binaries = folder / "resources", folder / "binaries" / ("linux64" if version == 2 else "x86_64-linux")
    resources.mkdir(parents=True)
    binaries.mkdir(parents=True)
    (folder / "modelDescription.xml").write_bytes(xml)
    (resources / "cell.json").write_text(text)
    for library in runtime.glob("*.so*"):
        shutil.copyfile(library, binaries / library.name)
    return folder


def rejection(cell: dict[str, Any]) -> str:
    """Message with which robotcell-describe rejects a cell description."""
    command = [str(runtime_folder() / "robotcell-describe"), "-", "--fmi", "3"]
    done = subprocess.run(command, input=json.dumps(cell), capture_output=True, text=True, check=False)
    assert done.returncode != 0
    return done.stderr


def pack(folder: Path, target: Path) -> Path:
    """Pack an FMU from its unpacked files."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for file in sorted(path for path in folder.rglob("*") if path.is_file()):
            archive.write(file, file.relative_to(folder))
    return target


# FMPy changes the process's working folder while it loads a library, and back to the one that it found.
_LOADING = threading.Lock()


@cache
def read_description(folder: Path) -> Any:
    """Model description of an unpacked FMU, which costs more time to read than an instance to start."""
    return fmpy.read_model_description(str(folder))


class CellFmu:
    """One FMU instance with access to variables by name; `messages` and `log` hold its log."""

    def __init__(
        self,
        folder: Path,
        parameters: Parameters | None = None,
        stop_time: float | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """`options` are passed to `instantiate`, for example eventModeUsed."""
        self.description = read_description(folder)
        self.version = int(self.description.fmiVersion[0])
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.log: list[tuple[int, str]] = []  # status and category of the messages
        slave = FMU2Slave if self.version == 2 else FMU3Slave
        with _LOADING:
            self.slave = slave(
                guid=self.description.guid, unzipDirectory=str(folder), modelIdentifier="RobotCell", instanceName="cell"
            )
        try:
            self.slave.instantiate(**self._callbacks(), **(options or {}))
        except Exception as error:
            raise RuntimeError("; ".join(self.messages)) from error
        try:
            self.initialize(parameters, stop_time)
        except Exception as error:
            self.close()
            raise RuntimeError("; ".join(self.messages)) from error

    def _callbacks(self) -> dict[str, Any]:
        if self.version == 3:
            return {"logMessage": lambda _env, *message: self._on_message(*message)}
        callbacks = fmi2CallbackFunctions()
        self.logger = fmi2CallbackLoggerTYPE(lambda _env, _name, *message: self._on_message(*message))
        callbacks.logger = self.logger
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        return {"callbacks": callbacks}

    def _on_message(self, status: int, category: bytes, text: bytes) -> None:
        self.messages.append(text.decode())
        self.log.append((status, category.decode()))

    def initialize(
        self, parameters: Parameters | None = None, stop_time: float | None = None, start_time: float = 0.0
    ) -> None:
        self.time_us = 0
        if self.version == 2:
            self.slave.setupExperiment(startTime=start_time, stopTime=stop_time)
            self.slave.enterInitializationMode()
        else:
            self.slave.enterInitializationMode(startTime=start_time, stopTime=stop_time)
        for name, value in (parameters or {}).items():
            self.set(name, value)
        self.slave.exitInitializationMode()

    def _references(self, names: Iterable[str]) -> list[int]:
        return [self.variables[name].valueReference for name in names]

    def set(self, name: str, value: float | int | str) -> None:
        kind = self.variables[name].type
        setter = {
            "Real": "setReal", "Float64": "setFloat64", "Integer": "setInteger", "Int32": "setInt32",
            "Boolean": "setBoolean", "Enumeration": "setInteger" if self.version == 2 else "setInt64",
        }  # fmt: skip
        getattr(self.slave, setter.get(kind, "setString"))(self._references([name]), [value])

    def get(self, *names: str) -> Array:
        """Values of real variables."""
        getter = self.slave.getReal if self.version == 2 else self.slave.getFloat64
        return np.array(getter(self._references(names)))

    def get_string(self, name: str) -> str:
        value = self.slave.getString(self._references([name]))[0]
        return str(value.decode() if isinstance(value, bytes) else value)

    def get_int(self, name: str) -> int:
        kind = self.variables[name].type
        getter = {
            "Integer": "getInteger", "Int32": "getInt32", "Boolean": "getBoolean",
            "Enumeration": "getInteger" if self.version == 2 else "getInt64",
        }[kind]  # fmt: skip
        return int(getattr(self.slave, getter)(self._references([name]))[0])

    def vector(self, prefix: str, count: int) -> Array:
        """Values of prefix[1] to prefix[count]."""
        return self.get(*(f"{prefix}[{i}]" for i in range(1, count + 1)))

    def command(self, q: Array | None = None, table: float | None = None, mode: int = 1) -> None:
        """Set servo set-points; joints without a value keep their start position."""
        self.set("command.mode", mode)
        for i, value in enumerate(START if q is None else q, start=1):
            self.set(f"command.q[{i}]", float(value))
        if table is not None:
            self.set("command.table", float(table))

    def start_move(self, q: Array | None = None, table: float | None = None, mode: int = 2) -> None:
        """Start a move (mode 2: of the joints); joints without a value keep their start position."""
        self.command(q, table, mode)
        self.set("command.start", self.get_int("command.start") + 1)

    def trigger(self, mode: int, interval: float = 0.0, exposure: float = 0.0, segment: int = 1) -> None:
        names = {1: "period", 2: "angle", 3: "distance", 5: "travel"}
        if mode in names:
            self.set(f"command.trigger.{names[mode]}", interval)
        self.set("command.exposure", exposure)
        self.set("command.segment", segment)
        self.set("command.trigger.mode", mode)

    def step(self, size_us: int, count: int = 1) -> None:
        for _ in range(count):
            self.slave.doStep(self.time_us * 1e-6, size_us * 1e-6)
            self.time_us += size_us

    def records(self, step_us: int, until_us: int) -> dict[int, Array]:
        """Step, switch the trigger off and collect every record: time, exposure, measured axes, all true values."""
        names = [n for n, v in self.variables.items() if n.startswith("trigger.") and v.type in {"Real", "Float64"}]
        found: dict[int, Array] = {}
        while self.time_us < until_us or len(found) < self.get_int("trigger.count"):
            if self.time_us >= until_us:
                self.trigger(0)
            self.step(step_us)
            index = self.get_int("trigger.index")
            if index and index not in found:
                found[index] = self.get(*names)
        return found

    def array(self, name: str) -> Array:
        """Values of a real array variable of FMI 3, in its shape."""
        shape = [int(d.start) for d in self.variables[name].dimensions]
        values = self.slave.getFloat64(self._references([name]), nValues=int(np.prod(shape)))
        return np.array(values).reshape(shape)

    def path_ahead(self) -> Array:
        """Path ahead of the controller (64, 7), of an FMU with the variant `--ahead`."""
        if self.version == 3:
            return self.array("controller.ahead")
        axes = [*(f"q[{i}]" for i in range(1, 7)), "table"]
        return self.get(*(f"controller.ahead[{k}].{axis}" for k in range(1, 65) for axis in axes)).reshape(64, 7)

    def body(self, name: str, prefix: str = "truth.") -> Array:
        """``world_from_body`` (4, 4) of a body."""
        w, x, y, z = self.vector(f"{prefix}{name}.orientation", 4)
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        matrix[:3, 3] = self.vector(f"{prefix}{name}.position", 3)
        return matrix

    def save(self) -> Any:
        return self.slave.getFMUstate() if self.version == 2 else self.slave.getFMUState()

    def restore(self, state: Any, time_us: int) -> None:
        (self.slave.setFMUstate if self.version == 2 else self.slave.setFMUState)(state)
        self.time_us = time_us

    def serialize(self, state: Any) -> bytes:
        return bytes((self.slave.serializeFMUstate if self.version == 2 else self.slave.serializeFMUState)(state))

    def deserialize(self, data: bytes) -> Any:
        return (self.slave.deSerializeFMUstate if self.version == 2 else self.slave.deserializeFMUState)(data)

    def free_state(self, state: Any) -> None:
        (self.slave.freeFMUstate if self.version == 2 else self.slave.freeFMUState)(state)

    def close(self) -> None:
        self.slave.freeInstance()


class FmuFolders:
    """Cache of FMUs by version, cell description and variants, the options of robotcell-describe."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._known: list[tuple[Any, Path]] = []

    def unpacked(self, version: int, cell: dict[str, Any], *variants: str) -> Path:
        """Folder with the unpacked files of an FMU."""
        key = (version, cell, variants)
        for known, folder in self._known:
            if known == key:
                return folder
        folder = write_fmu(cell, version, self._root / f"RobotCell{version}-{len(self._known)}", *variants)
        self._known.append((key, folder))
        return folder

    def packed(self, version: int, cell: dict[str, Any]) -> Path:
        """Path of a packed FMU."""
        folder = self.unpacked(version, cell)
        file = folder.with_suffix(".fmu")
        return file if file.exists() else pack(folder, file)


Build = Callable[..., CellFmu]


def all_reals(cell: CellFmu) -> Array:
    """Values of all real variables, in the order of the table."""
    return cell.get(*(n for n, v in cell.variables.items() if v.type in {"Real", "Float64"}))


def continue_motion(cell: CellFmu) -> None:
    """Continue a motion from the present state, with exposures, ending within a dynamics step."""
    for k in range(40):
        cell.command(START + 0.1 * np.sin(0.1 * k), 3.0 + 0.02 * k)
        cell.step(CYCLE_US // 2)
    cell.step(330)
