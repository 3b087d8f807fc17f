"""The run folder of a robot program, which `picture`, `animate`, `page` and `export` take."""

from __future__ import annotations

from pathlib import Path

from scancell.cell.recording import Recording, write_recording
from scancell.cell.snapshot import MotionLog
from scancell.config.choices import Engine
from scancell.output.manifest import command_words, manifest, resolved_toml
from scancell.output.run_files import write_json
from scancell.output.run_folder import RunFolder
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import write_cloud
from scancell.scanning.session import ScanSession

_INTERVAL_US = 30_000  # between poses: an acceleration of 5 m/s² departs from their straight connection by 0.6 mm
CLOUD = "cloud.ply"


class ProgramRecorder:
    """Records poses, exposures and clouds of a session from now on until `end`."""

    def __init__(self, session: ScanSession) -> None:
        self._session, self._listener = session, session.on_exposures
        self._motion = MotionLog(session.cell, _INTERVAL_US)
        self._exposures: list[Recording] = []
        self._clouds: list[Cloud] = []
        session.on_exposures = self._receive

    def _receive(self, recording: Recording, cloud: Cloud | None) -> None:
        self._exposures.append(recording)
        if cloud is not None:
            self._clouds.append(cloud)
        self._listener(recording, cloud)

    def end(self) -> None:
        """End the recording."""
        self._motion.end()
        self._session.on_exposures = self._listener

    def save(self, target: Path, program: Path, engine: Engine, with_cloud: bool) -> list[Path]:
        """Write the run folder of `program` and return its files; none if no simulated time has passed.

        ``cloud.ply`` holds the points of all clouds `with_cloud`.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        """
        motion, world = self._motion.recording, self._session.world
        if len(motion) < 2:
            return []
        has_part = any(body.moves_with == "part" for body in self._session.nominal.bodies)
        file = world.part_file
        run = {
            "program": str(program.absolute()),
            "part": str(file.absolute()) if file is not None else world.part if has_part else "",
            "unit": world.unit,
            "engine": engine,
            "as_built": list(world.as_built),
            "seed": world.seed,
            "command_line": command_words(None),
        }
        inputs = [program.absolute(), *([] if file is None else [file])]
        with RunFolder(target) as folder:
            write_recording(motion, folder.path("motion.parquet"))
            write_recording(Recording.joined([motion[:0], *self._exposures]), folder.path("recording.parquet"))
            if with_cloud and self._clouds:
                comments = (f"scancell run of {program.name}", "frame part")
                write_cloud(folder.path(CLOUD), Cloud.concatenate(self._clouds), comments)
            elif with_cloud:
                (target / CLOUD).unlink(missing_ok=True)  # of an earlier run
            folder.path("resolved.toml").write_text(resolved_toml(world.setup, run))
            write_json(folder.path("manifest.json"), manifest(world.setup, inputs, run))
        return folder.paths
