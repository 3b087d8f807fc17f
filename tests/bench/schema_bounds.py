"""`PYTHONPATH=tests python -m bench.schema_bounds OUT`: every numeric key of every schema at both ends of its range.

Each key of cell, robot, sensor, scan, path, artefact, study, batch and link is set to its smallest and largest value,
all others kept, and the description is used: a scan by rays, rendered images, a trial, packets over a link. Each run is
a process of its own with limits of processor time and memory. It may give an answer, whose figures are finite, or a
`ScancellError`; a traceback, an abort, a NaN or infinite figure, and a run beyond a limit are faults, and so is a
description that is refused without a change. Finished runs are kept in OUT/runs.csv and not repeated; `--only PATTERN`
selects keys, `--again` repeats the faults.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import math
import multiprocessing
import os
import re
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import chdir, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import fmpy
import numpy as np
from pydantic import Field, create_model

import scancell
from scancell.cell.fmu_file import build_fmu, cell_json, expected_keys
from scancell.cell.fmu_package import FmuOptions
from scancell.config.artefact import ArtefactDescription
from scancell.config.cell import LinkDescription
from scancell.config.choices import Engine
from scancell.config.description import Description, split_unit, validate
from scancell.config.files import assets_dir, join_path, plain_data, read_description, toml_text
from scancell.config.scan import PathDescription, ScanDescription
from scancell.config.study import BatchDescription, StudyDescription
from scancell.errors import ScancellError
from scancell.geometry.mesh import box_mesh
from scancell.geometry.mesh_files import write_stl
from scancell.guard.transport import Channel
from scancell.studies.batch import open_batch
from scancell.studies.study import open_study, replay

SECONDS = 60  # of processor time of a run
ELAPSED = 1200  # s, of a run that does not use the processor
MEMORY = 4 << 30  # bytes beyond those of the parent
ODD_TEXT = re.compile(r"\b(inf|nan|invalid value|overflow|divide)\b")
COLUMNS = ("case", "outcome", "seconds", "text")
Data = dict[str, Any]


@dataclass(frozen=True)
class Base:
    """A description with its tables filled, and what is done with it once a key that matches `keys` is changed."""

    name: str
    model: type[Description]
    data: Data
    use: Callable[[Data], Any]
    keys: str = ""


@dataclass(frozen=True)
class Case:
    """A key of a base and the value that it gets; without a path, the base itself."""

    base: Base
    path: tuple[str | int, ...] = ()
    value: float = math.nan

    @property
    def name(self) -> str:
        """Key and value."""
        if not self.path:
            return f"{self.base.name} unchanged"
        return f"{self.base.name}.{join_path(self.path)}={self.value!r}"

    @property
    def changed(self) -> Data:
        """Data of the base with the value."""
        data: Data = plain_data(self.base.data)
        if not self.path:
            return data
        node: Any = data
        for part in self.path[:-1]:
            node = node[part] if isinstance(part, int) else node.setdefault(part, {})
        node[self.path[-1]] = self.value
        return data


def limits_of(schema: Mapping[str, Any]) -> tuple[float, float]:
    """Smallest and largest value that a schema of a number permits."""
    whole = schema["type"] == "integer"
    low = schema.get("minimum", -math.inf)
    high = schema.get("maximum", math.inf)
    if "exclusiveMinimum" in schema:
        low = schema["exclusiveMinimum"] + 1 if whole else math.nextafter(schema["exclusiveMinimum"], math.inf)
    if "exclusiveMaximum" in schema:
        high = schema["exclusiveMaximum"] - 1 if whole else math.nextafter(schema["exclusiveMaximum"], -math.inf)
    return (int(low), int(high)) if whole and math.isfinite(low + high) else (low, high)


def numeric_keys(model: type[Description], data: Data) -> Iterator[tuple[tuple[str | int, ...], Mapping[str, Any]]]:
    """Path and schema of every numeric key that `data` holds or could hold."""
    whole = model.model_json_schema()

    def walk(schema: Any, value: Any, path: tuple[str | int, ...]) -> Iterator[Any]:
        if "$ref" in schema:
            yield from walk(whole["$defs"][schema["$ref"].rpartition("/")[2]], value, path)
        elif "anyOf" in schema or "oneOf" in schema:
            for option in schema.get("anyOf", schema.get("oneOf")):
                yield from walk(option, value, path)
        elif schema.get("type") in ("number", "integer") and not {"enum", "const"} & schema.keys():
            yield path, schema
        elif schema.get("type") == "object" and "properties" in schema:
            kind = schema["properties"].get("kind", {})
            if isinstance(value, dict) and "const" in kind and value.get("kind") != kind["const"]:
                return
            for key, below in schema["properties"].items():
                if isinstance(value, dict) and (key in value or "type" in below or "anyOf" in below):
                    yield from walk(below, value.get(key), (*path, key))
        elif schema.get("type") == "array" and isinstance(value, list | tuple):
            items = schema.get("prefixItems") or [schema.get("items", {})] * len(value)
            for position, item in enumerate(items[: len(value)]):
                yield from walk(item, value[position], (*path, position))

    seen = set()
    for path, schema in walk(whole, data, ()):
        if (path, str(schema)) not in seen:
            seen.add((path, str(schema)))
            yield path, schema


def cases_of(base: Base) -> Iterator[Case]:
    """The cases of a base: itself, and both ends of every numeric key in the first of several equal tables."""
    yield Case(base)
    for path, schema in numeric_keys(base.model, base.data):
        is_equal = path[0] not in ("shape", "factor", "light")  # tables of these lists are of different kinds
        is_later = is_equal and any(isinstance(part, int) and part for part in path[:-1])
        if is_later or not re.match(base.keys, join_path(path)):
            continue
        for value in dict.fromkeys(limits_of(schema)):
            yield Case(base, path, value)


# --- bases ------------------------------------------------------------------------------------------------------------

PART = box_mesh((0.04, 0.03, 0.02))
PART = replace(PART, vertices=PART.vertices + np.array([0.0, 0.0, 0.01]))  # it stands on the table
POSE = {"x_mm": 0.0, "y_mm": 0.0, "z_mm": 100.0, "rx_deg": 180.0, "ry_deg": 0.0, "rz_deg": 0.0}
STILL = {"pose": [POSE], "mode": "stop-and-look", "sweep": {"enabled": False}, "raster": {"enabled": False}}
SWEEP = {"max_profiles": 6, "raster": {"enabled": False}, "sweep": {"elevations_deg": [45.0]}}
FAST = {**SWEEP, "max_profiles": 2, "sweep": {"elevations_deg": [45.0], "speed_deg_s": 170.0}}
INERTIA = {"mass_kg": 1.0, "centre_of_mass_mm": [0.0, 0.0, 50.0], "inertia_kg_m2": [0.01, 0.01, 0.01]}
GROOVES = {"model": "grooved_conductor", "reflectance": 0.9, "roughness": 0.3, "roughness_along": 0.1}
GROOVES |= {"groove_axis": [0.0, 0.0, 1.0], "groove_centre_mm": [0.0, 0.0, 0.0]}
NORMAL = {"kind": "normal", "mean": 0.0, "std": 0.01}


def filled(model: type[Description], data: Data) -> Data:
    """Data with all defaults, without the keys whose value is None."""
    return dict(plain_data(validate(model, data, "base")))


def shipped(model: Any, name: str) -> Data:
    """Data of a shipped file, with its defaults."""
    return filled(model, read_description(model.kind, assets_dir() / f"{model.kind}s" / name)[0])


def scanned(engine: Engine, **given: Data) -> Any:
    """Figures and warnings of a scan of the part with descriptions as plain data."""
    models: dict[str, Any] = {
        "cell": scancell.CellDescription,
        "sensor": scancell.SensorDescription,
        "scan": ScanDescription,
    }
    made: dict[str, Any] = {key: validate(models[key], data, key) for key, data in given.items()}
    result = scancell.scan(PART, engine=engine, **made)
    return [result.figures, result.warnings]


def both(*calls: Callable[[], Any]) -> list[Any]:
    """Results of those calls that are not refused, of which there is one at least."""
    results, refusals = [], []
    for call in calls:
        try:
            results.append(call())
        except ScancellError as error:
            refusals.append(error)
    if not results:
        raise refusals[0]
    return results


def use_cell(data: Data) -> Any:
    """A planned sweep by rays."""
    return scanned("geometric", cell=data, scan=FAST)


def use_lit(data: Data) -> Any:
    """An exposure with images of few pixels, since lamps are integrated at each of them."""
    sensor = shipped(scancell.SensorDescription, "two_camera_probe.toml")
    for camera in sensor["camera"]:
        camera |= {"width_px": 320, "height_px": 256, "pixel_pitch_um": 20.0, "psf_sigma_px": 0.8}
    return scanned("ray-traced", cell=data, sensor=sensor, scan=STILL)


def use_session(data: Data) -> Any:
    """Commands to a belt, a gripper and an arm, and an exposure."""
    cell = validate(scancell.CellDescription, data, "cell")
    with scancell.Scanner(cell) as scanner, scanner.session(PART) as session:
        session.run_conveyor(1, 0.05)
        session.start_close_gripper(20.0)
        session.start_move_joints(session.home + 0.02, 0.1)
        session.wait(0.3)
        session.start_open_gripper(0.02)
        session.run_conveyor(1, 0.0)
        session.wait(0.2)
        values = [*session.joints, session.table_angle, session.gripper_width, session.conveyor_travel(1)]
        values += session.snapshot(1e-3).truth_at_middle("part[2]").ravel().tolist()
        return [*values, *session.profile("geometric").points_in_base.ravel()]


def use_sensor(data: Data) -> Any:
    """An exposure with images, and one by rays."""
    return both(
        lambda: scanned("ray-traced", sensor=data, scan=STILL), lambda: scanned("geometric", sensor=data, scan=STILL)
    )


def use_as_built(data: Data) -> Any:
    """Figures of an exposure by rays in a cell with deviations."""
    changed = {key: value for key, value in data.items() if value}
    scan = validate(ScanDescription, STILL, "scan")
    return scancell.scan(PART, scan=scan, engine="geometric", as_built=changed).figures


def use_scan(data: Data) -> Any:
    """A planned scan by rays."""
    return scanned("geometric", scan=data)


def use_occupied(data: Data) -> Any:
    """A planned sweep beside a cloud of points."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        np.savetxt("cloud.xyz", np.random.default_rng(1).uniform(-0.05, 0.05, (500, 3)) + np.array([0.0, 0.6, 0.1]))
        return scanned("geometric", scan=data)


def use_path(data: Data) -> Any:
    """A scan along a path, whose planning is limited to less work than the time of a run."""
    scan = {"max_profiles": 200, "sweep": {"enabled": False}, "raster": {"enabled": False}, "path": [data]}
    scan["max_planning_work"] = 25.0
    return scanned("geometric", scan=scan)


def use_study(data: Data) -> Any:
    """The design of a study, and its first trial."""
    with _files("study.toml", validate(StudyDescription, data, "study")):
        row, _ = replay(open_study(Path("study.toml")), 1)
        return row["figures"]


def use_batch(data: Data) -> Any:
    """The scans of a batch, which are not made."""
    batch = validate(BatchDescription, data, "batch")
    with _files("batch.toml", batch):
        return len(open_batch(batch, Path("batch.toml"), [Path("part.stl")], Path("out")).tasks)


@contextmanager
def _files(name: str, description: Description) -> Iterator[None]:
    """A folder with the part and a description, which is the current one."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        write_stl(Path("part.stl"), 1e3 * PART.vertices, PART.faces)
        Path(name).write_text(toml_text(description.model_dump(exclude_defaults=True)), encoding="utf-8")
        yield


def use_artefact(data: Data) -> Any:
    """A scan of an artefact by rays."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "artefact.toml"
        validate(ArtefactDescription, data, "artefact").to_toml(file)
        return scancell.scan(file, engine="geometric", scan=validate(ScanDescription, STILL, "scan")).figures


def use_link(data: Data) -> Any:
    """Packets over a faulty network."""
    link = validate(LinkDescription, data, "link")
    channel = Channel(link.to_guard, seed=1)
    for number in range(1000):
        channel.send(b"packet", 0.02 * number)
    return [arrival.time for arrival in channel.receive(1e3)]


def cell_bases() -> list[Base]:
    """Cells whose keys are varied."""
    default = shipped(scancell.CellDescription, "default.toml")
    cell = plain_data(default)
    cell["tool"]["inertia"] = {**INERTIA, "products_kg_m2": [0.0, 0.0, 0.0]}
    cell["part"] |= {
        "material": GROOVES,
        "material_region": [{"material": {"preset": "marble"}, "min_mm": [0.0] * 3, "max_mm": [1.0] * 3}],
    }
    cell["light"] = [
        {"kind": "rectangle", "power_mw": 10.0, "width_mm": 50.0, "height_mm": 50.0, "in_band": 0.1, "pose": POSE},
        {"kind": "disc", "power_mw": 10.0, "diameter_mm": 50.0, "wavelength_nm": 650.0, "bandwidth_nm": 50.0},
    ]
    cell["presence_sensor"] = [{"name": "gate", "x_size_mm": 10.0, "y_size_mm": 10.0, "z_size_mm": 10.0}]
    cell["distance_sensor"] = [{"name": "height", "farthest_mm": 300.0}]
    cell["light_curtain"] = [{"name": "curtain", "width_mm": 500.0, "height_mm": 300.0, "beam_spacing_mm": 60.0}]
    cell["conveyor"] = [{"name": "belt", "pose": {"x_mm": 900.0}, "length_mm": 400.0, "width_mm": 200.0}]
    cell["tcp"] = [{"name": "tip", "flange_from_tcp": {"z_mm": 80.0}}]
    cell["frame"] = [{"name": "corner", "pose": {"x_mm": 100.0}}]
    cell["estimated"] = {"tool": {}, "dh": [{} for _ in cell["robot"]["joint"]]}
    picking = shipped(scancell.CellDescription, "pick_and_place.toml")
    block = str(assets_dir() / "parts/step_block.stl")
    picking["further_part"] = [{"name": "other", "mesh": block, "pose": {"x_mm": 80.0}}]
    soft = plain_data(picking)
    soft["further_part"][0]["soft"] = {"stiffness_n_mm": 0.1}
    cell["obstacle"] = [{"name": "post", "mesh": block, "pose": {"y_mm": 700.0}}]
    dynamic = plain_data(default)
    dynamic["robot"]["drive"] = "dynamic"
    for joint in dynamic["robot"]["joint"]:
        joint["inertia"] = INERTIA
        joint["drive"] = {"motor_inertia_kg_m2": 0.1, "max_torque_n_m": 200.0, "gear_stiffness_n_m_rad": 2e4}
        joint["drive"] |= {"gear_damping_n_m_s_rad": 10.0}
    seven: Data = shipped(scancell.CellDescription, "seven_axis.toml")
    seven["robot"]["held"][0]["values_deg"] = [0.0]
    cells = scancell.CellDescription
    return [
        Base("cell", cells, filled(cells, cell), use_cell, "(?!light|part.material)"),
        Base("lit", cells, filled(cells, cell), use_lit, r"light(?!_)|part\.|.*reflectance|table\.(pose|radius|thick)"),
        Base(
            "picking", cells, filled(cells, picking), use_session, "gripper|conveyor|further_part|part.arrival|contact"
        ),
        Base("soft", cells, filled(cells, soft), use_session, "further_part.*(soft|density)"),
        Base("dynamic", cells, filled(cells, dynamic), use_cell, r"robot\.joint|robot\.link|world"),
        Base("seven", cells, seven, use_cell, "robot.held"),
    ]


@cache
def as_built_model() -> type[Description]:
    """Deviations as built of the default cell as a description, with the bounds that the FMU declares."""
    cell = scancell.CellDescription.default()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cell.fmu"
        build_fmu(cell_json(cell, scancell.nominal_cell(cell, PART), 0), file, 2, FmuOptions())
        variables = fmpy.read_model_description(str(file)).modelVariables
    found = {v.name: v for v in variables if v.name.startswith("as_built.")}
    units = {name: v.declaredType.unit if v.declaredType else v.unit for name, v in found.items()}
    fields: dict[str, Any] = {}
    for key in expected_keys(units):
        name, scale = split_unit(key)
        low, high = (float(end) / scale for end in (found[f"as_built.{name}"].min, found[f"as_built.{name}"].max))
        fields[key] = (Annotated[float, Field(ge=low, le=high)], 0.0)
    return create_model("AsBuilt", __base__=Description, **fields)


def bases() -> list[Base]:
    """The descriptions whose keys are varied."""
    sensor = shipped(scancell.SensorDescription, "two_camera_probe.toml")
    wide = plain_data(sensor)
    wide["laser"] |= {"profile": "table", "profile_angle_deg": [-20.0, 0.0, 20.0], "profile_power": [1.0, 2.0, 1.0]}
    wide["laser"]["straightness_mrad"] = [0.0] * 6
    wide["exposure"] = {"mode": "automatic", "shortest_ms": 0.1, "longest_ms": 10.0}
    wide["detector"] |= {
        "shutter": "rolling",
        "row_readout_us": 5.0,
        "hot_pixels_ppm": 10.0,
        "hot_pixel_e_per_s": 100.0,
    }
    for camera in wide["camera"]:
        camera |= {"focus_mm": 120.0, "region_columns_px": [0, camera["width_px"]], "region_rows_px": [0, 512]}
    burst = plain_data(sensor)
    burst["exposure"] = {"mode": "multiple", "further_ms": [0.5]}
    burst["laser"] |= {"profile": "gaussian", "profile_half_width_deg": 20.0}
    path: Data = {"waypoint": [{"x_mm": x, "y_mm": 0.0, "z_mm": 20.0} for x in (-10.0, 10.0)]}
    path |= {"quality": {"pair": [{"bodies": ["sensor", "part"], "full_clearance_mm": 40.0}]}, "weights": {}}
    study: Data = {"name": "ends", "part": "part.stl", "seed": 1, "design": {"kind": "monte_carlo", "trials": 4}}
    study["set"] = ["scan.max_profiles=6", "scan.raster.enabled=false", "scan.sweep.elevations_deg=[45]"]
    kinds = [NORMAL, {"kind": "uniform", "low": -0.01, "high": 0.01}, {**NORMAL, "kind": "truncated_normal"}]
    kinds[2] |= {"low": -0.02, "high": 0.02}
    kinds.append({"kind": "discrete", "values": [0.0, 0.01], "weights": [0.5, 0.5]})
    keys = ("as_built.tool.x_mm", "as_built.tool.y_mm", "cell.part.x_mm", "sensor.laser.offset_x_mm")
    study["factor"] = [{"path": key, "distribution": kind} for key, kind in zip(keys, kinds, strict=True)]
    study["block"] = [{"paths": ["as_built.table.x_mm", "as_built.table.y_mm"], "mean": [0.0, 0.0]}]
    study["block"][0] |= {"covariance": [[1e-4, 0.0], [0.0, 1e-4]]}
    study["sphere"] = [{"name": "ball", "centre_mm": [0.0, 0.0, 10.0], "radius_mm": 10.0}]
    batch = {key: study[key] for key in ("seed", "design", "factor", "block")} | {"set": study["set"]}
    shapes = [
        {"kind": "sphere", "name": "ball", "diameter_mm": 20.0},
        {"kind": "plane", "name": "face", "size_mm": [20.0, 20.0], "pose": {"x_mm": 20.0}},
        {"kind": "box", "name": "block", "size_mm": [10.0, 10.0, 10.0], "pose": {"x_mm": -20.0}},
        {"kind": "cylinder", "name": "pin", "diameter_mm": 10.0, "height_mm": 10.0, "pose": {"y_mm": 20.0}},
        {"kind": "cone", "name": "tip", "bottom_diameter_mm": 10.0, "top_diameter_mm": 5.0, "height_mm": 10.0},
        {"kind": "ring", "name": "ring", "inner_diameter_mm": 5.0, "outer_diameter_mm": 10.0, "height_mm": 5.0},
    ]
    sensors = scancell.SensorDescription
    occupied = {**SWEEP, "occupied": [{"file": "cloud.xyz"}]}
    raster = {"max_profiles": 6, "sweep": {"enabled": False}}
    scan = filled(ScanDescription, {**SWEEP, "pair_clearance": [{"bodies": ["sensor", "part"], "clearance_mm": 6.0}]})
    return [
        *cell_bases(),
        Base("as_built", as_built_model(), filled(as_built_model(), {}), use_as_built),
        Base("sensor", sensors, sensor, use_sensor),
        Base("wide", sensors, filled(sensors, wide), use_sensor, "laser|exposure|detector|camera"),
        Base("burst", sensors, filled(sensors, burst), use_sensor, "exposure.further|laser.profile_half"),
        Base("scan", ScanDescription, scan, use_scan),
        Base("raster", ScanDescription, filled(ScanDescription, raster), use_scan, "raster"),
        Base(
            "coverage",
            ScanDescription,
            filled(ScanDescription, {**SWEEP, "coverage": {"enabled": True}}),
            use_scan,
            "coverage|sweep",
        ),
        Base("still", ScanDescription, filled(ScanDescription, STILL), use_scan, "pose|settle|table"),
        Base("occupied", ScanDescription, filled(ScanDescription, occupied), use_occupied, "occupied"),
        Base("path", PathDescription, filled(PathDescription, path), use_path),
        Base("spiral", PathDescription, filled(PathDescription, {"spiral": {}, "pitch_mm": 5.0}), use_path, "spiral"),
        Base(
            "contour",
            PathDescription,
            filled(PathDescription, {"contour": {"height_mm": 10.0}, "pitch_mm": 5.0}),
            use_path,
            "contour",
        ),
        Base("artefact", ArtefactDescription, filled(ArtefactDescription, {"shape": shapes}), use_artefact),
        Base("study", StudyDescription, filled(StudyDescription, study), use_study),
        Base("batch", BatchDescription, filled(BatchDescription, batch), use_batch),
        Base("link", LinkDescription, filled(LinkDescription, {"to_guard": {}}), use_link),
    ]


# --- runs -------------------------------------------------------------------------------------------------------------


def odd_figures(value: Any, name: str = "") -> list[str]:
    """Names of the figures that are NaN or infinite."""
    if isinstance(value, Mapping):
        return [odd for key, item in value.items() for odd in odd_figures(item, f"{name}.{key}")]
    if isinstance(value, str):
        return [value] if ODD_TEXT.search(value) else []
    if isinstance(value, list | tuple):
        return [odd for number, item in enumerate(value) for odd in odd_figures(item, f"{name}[{number}]")]
    return [name] if isinstance(value, float | np.floating) and not math.isfinite(value) else []


def outcome_of(case: Case) -> tuple[str, str]:
    """Outcome and text of a case in this process."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            odd = odd_figures(case.base.use(case.changed))
        except ScancellError as error:
            lacks_file = "no such file" in str(error)  # all files of the bases are there
            return ("refused base" if lacks_file or not case.path else "refused"), str(error)
        except Exception as error:
            frames = traceback.extract_tb(error.__traceback__)
            where = next((f for f in reversed(frames) if "scancell" in f.filename), frames[-1])
            return "traceback", f"{Path(where.filename).name}:{where.lineno}: {type(error).__name__}: {error}"
    numerical = [str(item.message) for item in caught if issubclass(item.category, RuntimeWarning)]
    odd += [text for text in numerical if ODD_TEXT.search(text)]
    return ("odd figure", ", ".join(dict.fromkeys(odd))) if odd else ("answer", "")


def _child(case: Case, sender: Any) -> None:
    used = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    resource.setrlimit(resource.RLIMIT_CPU, (int(used) + SECONDS, int(used) + SECONDS + 5))
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sender.send((*outcome_of(case), sorted(sys.modules)))


def _import(modules: Iterable[str]) -> None:
    """Import what a run has imported, so that the following ones need not."""
    for name in modules:
        if name not in sys.modules and name.partition(".")[0] in ("scancell", "scipy", "numpy"):
            with suppress(ImportError):
                importlib.import_module(name)


def _ended_processes() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_case(case: Case) -> tuple[str, float, str]:
    """Outcome, processor time (s) and text of a case in a process of its own."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(case, sender))
    start = _ended_processes()
    process.start()
    sender.close()
    outcome = ("aborted", "")
    with suppress(EOFError):
        if receiver.poll(ELAPSED):
            *outcome, modules = receiver.recv()
            _import(modules)
        else:
            outcome = ("endless", f"{ELAPSED} s")
    process.join(5)
    if process.is_alive():
        process.kill()
        process.join()
    if outcome[0] == "aborted" and process.exitcode is not None:
        ended = signal.Signals(-process.exitcode).name if process.exitcode < 0 else f"code {process.exitcode}"
        outcome = ("endless", f"{SECONDS} s of processor time") if ended == "SIGXCPU" else ("aborted", ended)
    return outcome[0], _ended_processes() - start, outcome[1]


def main() -> None:
    """Run the cases that are not in the table yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", default="", help="regular expression of keys, such as scan.sweep")
    parser.add_argument("--again", action="store_true", help="repeat the faults")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    table = options.out / "runs.csv"
    rows = {}
    if table.exists():
        with table.open(newline="", encoding="utf-8") as stream:
            rows = {row["case"]: row for row in csv.DictReader(stream)}
    cases = [case for base in bases() for case in cases_of(base)]
    for case in cases:
        done = case.name in rows and not (options.again and rows[case.name]["outcome"] not in ("answer", "refused"))
        if done or not re.search(options.only, case.name):
            continue
        outcome, seconds, text = run_case(case)
        rows[case.name] = dict(
            zip(COLUMNS, (case.name, outcome, f"{seconds:.1f}", text.replace("\n", "; ")), strict=True)
        )
        with table.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, COLUMNS)
            writer.writeheader()
            writer.writerows(rows.values())
        if outcome not in ("answer", "refused"):
            print(f"{case.name}: {outcome} after {seconds:.1f} s: {text}", flush=True)
    counts = Counter(rows[case.name]["outcome"] for case in cases if case.name in rows)
    keys = len({(case.base.name, case.path) for case in cases if case.path})
    print(f"{keys} keys, {len(cases)} cases, {sum(counts.values())} run: {dict(counts)}")


if __name__ == "__main__":
    main()
