"""`PYTHONPATH=tests python -m bench.scan_stations`: where the processor time of a scan goes, for docs/run_time.md.

Two tables, for ray-traced and geometric scans. The first is by step of the command, from the clock of the process, for
all threads together; what precedes the first step is start-up and imports. The second is by library, and within the
compiled module of the sensor by source file, from a sampling profiler: `perf`, and the libraries that `make setup` left
in `build` with their symbols.
"""

from __future__ import annotations

import argparse
import bisect
import collections
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from scancell.config.loading import assets_dir

from .run_time import PAGE
from .table import cpu_model, replace_paragraphs

ROOT = Path(__file__).resolve().parents[2]
# The command with its stopwatch on processor time; the last line that it prints is JSON.
COMMAND = """
import sys, time
from types import SimpleNamespace
import scancell.progress
scancell.progress.time = SimpleNamespace(perf_counter=time.process_time, monotonic=time.monotonic, sleep=time.sleep)
from scancell.cli import main
main()
"""
STEPS = {
    "load": "load cell and part",
    "plan": "plan",
    "drive": "drive the cell",
    "sense": "sense",
    "reconstruct": "reconstruct, normals",
    "evaluate": "deviation, coverage",
    "write": "write files",
    "draw": "pictures",
}
# Stations of the sensor's module: beginnings of source files relative to sensor_rt.
STATIONS = {
    "mesh of the lit surface": ("render/stripe/laser_mesh", "render/stripe/stripe_samples"),
    "light in pixels": ("render/stripe/", "render/emitter"),
    "other rendering": ("render/", "optics/"),
    "rays around Embree": ("tracing/",),
    "detector": ("detector/",),
    "extraction, triangulation": ("imaging/",),
    "laser fan (geometric engine)": ("fan/", "pipeline/"),
    "closest points, normals, coverage": ("scene/", "cloud/", "visibility/"),
}
LIBRARIES = {
    "libembree": "Embree",
    "python3": "Python interpreter",
    "_multiarray_umath": "NumPy",
    "[": "kernel",
}


def source_files(build: Path) -> dict[str, str]:
    """Source files, relative to sensor_rt, of the functions in the module's static libraries by linker name."""
    files = {}
    for archive in (build / "sensor_rt").glob("*/libsensor_rt_*.a"):
        objects = {path.name: path for path in archive.parent.rglob("*.cpp.o")}
        for line in _lines("nm", "-A", "--defined-only", str(archive)):
            *_, object_name, rest = line.split(":", 2)
            folder = re.sub(r"CMakeFiles/[^/]*/", "", str(objects[object_name].relative_to(build / "sensor_rt")))
            files[rest.split()[-1]] = folder
    return files


class Module:
    """The sensor's compiled module with symbols: finds the station of an address."""

    def __init__(self, build: Path) -> None:
        (library,) = (build / "sensor_rt/bindings").glob("_native*.so")
        files = source_files(build)
        rows = (line.split() for line in _lines("nm", "-n", "--defined-only", str(library)))
        functions = [(int(row[0], 16), files.get(row[2], "")) for row in rows if row[1] in "tTwWi"]
        self._starts = [start for start, _ in functions]
        self._files = [file for _, file in functions]

    def station(self, address: int) -> str:
        """The station of the function that contains it."""
        file = self._files[max(0, bisect.bisect_right(self._starts, address) - 1)]
        known = (name for name, starts in STATIONS.items() if file and file.startswith(starts))
        return next(known, "other of the module")


def run(engine: str, folder: Path, recorder: list[str]) -> dict[str, float]:
    """Processor seconds by step of one scan; `recorder` is put before the command."""
    part = str(assets_dir() / "parts/free_form.stl")
    words = ["scan", part, "--engine", engine, "--out", str(folder / "run"), "--json"]
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen([*recorder, sys.executable, "-c", COMMAND, *words], stdout=out, stderr=err)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            err.seek(0)
            raise SystemExit(f"the scan failed: {err.read()}")
        out.seek(0)
        seconds = json.loads(out.read().splitlines()[-1])["timings"]
    by_step = {name: seconds.get(key, 0.0) for key, name in STEPS.items()}
    return {"start-up, imports": used.ru_utime + used.ru_stime - sum(by_step.values()), **by_step}


def profiled(engine: str, folder: Path, build: Path) -> dict[str, float]:
    """Processor seconds by library and station of one scan."""
    data = folder / "perf.data"
    run(engine, folder, ["perf", "record", "-q", "-F", "397", "-o", str(data)])
    module = Module(build)
    counts: collections.Counter[str] = collections.Counter()
    options = ["--no-children", "--sort", "dso,sym", "-F", "sample,dso,sym", "--stdio", "-t", "|"]
    for line in _lines("perf", "report", "-i", str(data), "-v", *options):
        fields = [field.strip() for field in line.split("|")]
        if line.startswith("#") or len(fields) < 3 or not fields[0].isdigit():
            continue
        count, library, symbol = int(fields[0]), Path(fields[1].split()[0]).name, fields[2]
        address = re.search(r"0x[0-9a-f]+", symbol)
        if library.startswith("_native") and "/sensor/" in fields[1] and address:
            counts[module.station(int(address[0], 16))] += count
        else:
            counts[
                next((name for start, name in LIBRARIES.items() if library.startswith(start)), "other libraries")
            ] += count
    return {name: count / 397 for name, count in counts.items()}


def _lines(*command: str) -> list[str]:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def table(title: str, by_engine: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A table of processor seconds; stations in descending order of the first engine."""
    engines = list(by_engine)
    names = dict.fromkeys(name for seconds in by_engine.values() for name in seconds)
    order = sorted(names, key=lambda name: -by_engine[engines[0]].get(name, 0.0))
    rows = [[f"{by_engine[engine].get(name, 0.0):.2f}" for engine in engines] for name in order]
    total = [f"{sum(by_engine[engine].values()):.1f}" for engine in engines]
    return [
        f"| {title} | {' | '.join(engines)} |",
        "| --- " * (1 + len(engines)) + "|",
        *(f"| {name} | {' | '.join(row)} |" for name, row in zip(order, rows, strict=True)),
        f"| all | {' | '.join(total)} |",
    ]


def main() -> None:
    """Measure, print, and write the page."""
    parser = argparse.ArgumentParser(prog="python -m bench.scan_stations", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE, help="page whose tables are replaced")
    options = parser.parse_args()
    engines = ("ray-traced", "geometric")
    build = next(ROOT.glob("build/cp3*"), None)
    with tempfile.TemporaryDirectory(prefix="scancell-stations-") as name:
        os.environ["SCANCELL_CACHE"] = str(Path(name) / "cache")
        run("geometric", Path(name), [])  # computes the measurable surface, once for all
        tables = {"| step |": table("step", {engine: run(engine, Path(name), []) for engine in engines})}
        if shutil.which("perf") is None or build is None:
            print("no table by library: it needs the profiler `perf` (Debian: linux-perf) and the folder `build`")
        else:
            found = {engine: profiled(engine, Path(name), build) for engine in engines}
            tables["| library or station |"] = table("library or station", found)
    for lines in tables.values():
        print("\n".join(lines), end="\n\n")
    replace_paragraphs(options.page, {"Processor seconds of the default": [_caption()], **tables})


def _caption() -> str:
    return f"Processor seconds of the default scan, one run on {cpu_model()}, by `python -m bench.scan_stations`."


if __name__ == "__main__":
    main()
