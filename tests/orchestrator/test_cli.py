"""Command line: exit codes, output streams, JSON, error reports."""

from __future__ import annotations

import json
import re
import shutil
import sys

import numpy as np
import pytest
import typer

from scancell import cli
from scancell.cli import common, scan
from scancell.cli.common import GROUPS
from scancell.config.loading import assets_dir, load_setup
from scancell.config.robot import RobotDescription
from scancell.errors import MeshError, ScancellError
from scancell.geometry import pose
from scancell.nominal.cell import arm_of


def call(monkeypatch, capsys, *words: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command run in this process."""
    monkeypatch.setattr(sys, "argv", ["scancell", *words])
    monkeypatch.setattr(cli.INTERRUPTS, "install", lambda: None)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    streams = capsys.readouterr()
    return int(ended.value.code or 0), streams.out, streams.err


def run(work, as_json: bool) -> int:
    try:
        common.run("version", as_json, work)
    except common.typer.Exit as ended:
        return int(ended.exit_code)
    return 0


def fail(error: BaseException):
    def work() -> common.Outcome:
        raise error

    return work


DONE = common.Outcome(["a line"], {"points": 3}, ["a file"], ["take care"], {"load": 0.5})


def test_text_output(capsys) -> None:
    assert run(lambda: DONE, as_json=False) == 0
    streams = capsys.readouterr()
    assert streams.out == "a line\n"
    assert streams.err == "warning: take care\n"


def test_json_output_is_one_object(capsys) -> None:
    assert run(lambda: DONE, as_json=True) == 0
    streams = capsys.readouterr()
    assert json.loads(streams.out) == {
        "command": "version",
        "ok": True,
        "figures": {"points": 3},
        "files": ["a file"],
        "warnings": ["take care"],
        "timings": {"load": 0.5},
    }
    assert streams.err.splitlines() == ["a line", "warning: take care"]


@pytest.mark.parametrize("error", [ScancellError("broken"), MeshError("broken")])
def test_scancell_errors_exit_with_code_1(capsys, error) -> None:
    assert run(fail(error), as_json=True) == 1
    streams = capsys.readouterr()
    assert streams.err == "scancell: broken\n"
    report = json.loads(streams.out)
    assert report == {"command": "version", "ok": False, "error": {"kind": type(error).__name__, "message": "broken"}}


def test_errors_and_warnings_name_the_options_of_the_command(monkeypatch, capsys) -> None:
    """Each command has its own options: one without `--unit` leaves the argument's name as it is."""
    code, _, err = call(monkeypatch, capsys, "place", "part.stl", "--set", "scan.max_profiles=0")
    assert code == 1
    assert err.startswith("scancell: --set scan.max_profiles=0: max_profiles = 0: must be")
    doubtful = common.Outcome(warnings=["2 mm: `unit` m makes it 2 m"])
    for command, said in (("scan", "--unit"), ("version", "`unit`")):
        common.run(command, False, lambda: doubtful)
        assert capsys.readouterr().err == f"warning: 2 mm: {said} m makes it 2 m\n"


def test_every_command_has_options_to_name() -> None:
    commands = typer.main.get_command(common.app).commands
    names = [f"{name} {sub}".strip() for name, one in commands.items() for sub in getattr(one, "commands", [""])]
    assert "study resume" in names
    for name in names:
        assert common.options_by_argument(name)["as_json"] == "--json"


def test_interrupt_exits_with_code_130(capsys) -> None:
    assert run(fail(KeyboardInterrupt()), as_json=False) == 130
    streams = capsys.readouterr()
    assert streams.out == ""
    assert streams.err == "scancell: interrupted\n"


def test_unexpected_exception_propagates() -> None:
    with pytest.raises(ZeroDivisionError):
        run(fail(ZeroDivisionError()), as_json=True)


@pytest.mark.parametrize("words", [["--help"], ["scan", "--help"], ["fmu", "build", "-h"]])
def test_help(monkeypatch, capsys, words) -> None:
    code, out, _ = call(monkeypatch, capsys, *words)
    assert code == 0
    assert "Usage" in out


@pytest.mark.parametrize(
    ("words", "command"),
    [(["scan", "--json"], "scan"), (["fmu", "info", "--json"], "fmu info"), (["sacn", "--json"], "")],
)
def test_usage_error_in_json(monkeypatch, capsys, words, command) -> None:
    code, out, err = call(monkeypatch, capsys, *words)
    assert code == 2
    assert "Usage" in err
    report = json.loads(out)
    assert report["command"] == command
    assert report["error"]["kind"] == "UsageError"
    assert report["error"]["message"] in err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["scan", "a.stl", "--sensor", "a.toml", "--sensor", "b.toml"], "--sensor"),
        (["scan", "a.stl", "--out=a", "--out", "b"], "--out"),
        (["scan", "a.stl", "--set", "scan.seed=1", "--set", "scan.seed = 2"], "--set scan.seed"),
        (["study", "run", "a.toml", "--set", "design.trials=1", "--set", "design.trials=1"], "--set design.trials"),
        (["shot", "--as-built", "tool.x_mm=1", "--as-built", "tool.x_mm=2"], "--as-built tool.x_mm"),
    ],
)
def test_option_of_one_value_given_twice_is_refused(monkeypatch, capsys, words, named) -> None:
    code, _, err = call(monkeypatch, capsys, *words)
    assert code == 2
    assert f"{named} is given 2 times, but has one value" in err


def test_flags_and_keys_that_differ_may_repeat(monkeypatch, capsys) -> None:
    assert call(monkeypatch, capsys, "version", "--json", "--json")[0] == 0
    words = ["scan", "none.stl", "--set", "scan.seed=1", "--set", "scan.speed_mm_s=2"]
    assert "is given" not in call(monkeypatch, capsys, *words)[2]


@pytest.mark.parametrize("text", ["1,2,3", "", "1,2,3,4,5,x", "1,2,3,4,5,inf", "1,2,3,4,5,6,7"])
def test_pose_option_needs_six_numbers(text) -> None:
    with pytest.raises(ScancellError, match="--pose"):
        scan._numbers(text, 6, "--pose")


def test_pose_option_accepts_signs_and_spaces() -> None:
    assert scan._numbers("1, -2,3e1,0,0,.5", 6, "--pose") == (1.0, -2.0, 30.0, 0.0, 0.0, 0.5)


def test_robot_from_urdf(monkeypatch, capsys, tmp_path) -> None:
    urdf = assets_dir() / "robots" / "seven_axis_urdf" / "seven_axis.urdf"
    words = ["robot", "from-urdf", "--tip", "flange", "--hold", "3", "--out", str(tmp_path / "arm.toml"), "--json"]
    code, out, _ = call(monkeypatch, capsys, *words, str(urdf))
    assert code == 0
    answer = json.loads(out.splitlines()[-1])
    assert answer["figures"] == {"joints": 7}
    assert answer["files"][0] == str(tmp_path / "arm.toml")
    assert answer["warnings"] == []
    assert len(RobotDescription.from_toml(tmp_path / "arm.toml").joint) == 7

    lonely = tmp_path / "lonely.urdf"
    lonely.write_text(urdf.read_text())
    code, _, err = call(monkeypatch, capsys, *words, str(lonely))
    assert code == 1
    assert "link 'link0': mesh 'package://seven_axis_urdf/meshes/link0.stl': no such file" in err


def test_robot_from_urdf_with_its_cell(monkeypatch, capsys, tmp_path) -> None:
    """The shipped arm on a track, beside a turntable and a fence."""
    source = assets_dir() / "robots" / "seven_axis_urdf"
    shutil.copytree(source, tmp_path / "seven_axis_urdf")
    urdf = tmp_path / "seven_axis_urdf" / "seven_axis.urdf"
    limit = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
    around = [
        ("rail", "prismatic", "link0", limit),
        ("turn", "continuous", "plate", limit),
        ("post", "fixed", "pole", ""),
    ]
    shape = '<visual><geometry><cylinder radius="0.15" length="0.02"/></geometry></visual>'
    text = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="floor"/><child link="{child}"/>{more}</joint>'
        + (f'<link name="{child}">{shape}</link>' if child != "link0" else "")
        for name, kind, child, more in around
    )
    urdf.write_text(urdf.read_text().replace("</robot>", f'<link name="floor"/>{text}</robot>'))
    words = ["robot", "from-urdf", str(urdf), "--tip", "flange", "--hold", "3", "--out", str(tmp_path / "arm.toml")]
    more = ["--cell", str(tmp_path / "cell.toml"), "--table", "plate", "--base", "link0"]
    code, out, _ = call(monkeypatch, capsys, *words, *more)
    assert code == 0
    assert "cell.toml: 1 axes, 1 obstacles" in out
    assert "world carries the table, axis 'rail', obstacle 'pole'" in out
    assert "rail carries the arm" in out
    code, out, _ = call(monkeypatch, capsys, *words, *more, "--json")
    assert json.loads(out.splitlines()[-1])["figures"] == {"joints": 7, "axes": 1, "obstacles": 1}
    assert load_setup(tmp_path / "cell.toml").cell.robot_moves_with == "rail"
    code, _, err = call(monkeypatch, capsys, *words)
    assert code == 1
    assert "the joints 'rail' move the base of the arm" in err
    assert "expected --cell, the file of a cell" in err


def test_tip_that_is_no_flange_is_reported(monkeypatch, capsys, tmp_path) -> None:
    source = assets_dir() / "robots" / "seven_axis_urdf"
    folder = tmp_path / "seven_axis_urdf"
    shutil.copytree(source, folder)
    urdf = folder / "seven_axis.urdf"
    urdf.write_text(urdf.read_text().replace('xyz="0 0 0.045" rpy="0 0 0"', 'xyz="0.03 0 0.045" rpy="0 0 0.5"'))
    words = ["robot", "from-urdf", str(urdf), "--tip", "flange", "--hold", "3", "--out", str(tmp_path / "arm.toml")]
    code, _, err = call(monkeypatch, capsys, *words)
    assert code == 0
    assert "its pose on the flange" in err
    printed = dict(re.findall(r"(\w+) = (-?[\d.]+)", err))
    position = np.array([float(printed[key]) for key in ("x_mm", "y_mm", "z_mm")]) * 1e-3
    angles = np.radians([float(printed[key]) for key in ("rx_deg", "ry_deg", "rz_deg")])
    flange = arm_of(RobotDescription.from_toml(tmp_path / "arm.toml")).fk(np.zeros(7))
    tip = flange @ pose.from_euler_xyz(position, angles)
    expected = pose.from_euler_xyz((0.03, 0.0, 0.34 + 0.4 + 0.4 + 0.08 + 0.045), (0, 0, 0.5))
    assert np.abs(tip - expected).max() < 1e-7


def test_help_lists_every_command_once(monkeypatch, capsys):
    listed = [name for names in GROUPS.values() for name in names]
    assert sorted(listed) == sorted(typer.main.get_command(cli.app).commands)
    code, text, _ = call(monkeypatch, capsys, "--help")
    assert code == 0
    assert re.findall(r"^(\w[\w ]+):$", text, re.MULTILINE) == ["Options", *GROUPS]
    assert "..." not in text.partition("\nScan:")[2]
