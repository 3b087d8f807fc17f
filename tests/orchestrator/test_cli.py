"""The command line around the work: exit codes, streams, JSON, and how an error of any kind is told."""

from __future__ import annotations

import json
import sys

import pytest

from orchestrator import cli
from orchestrator.cli import common
from orchestrator.errors import MeshError, ScancellError


def call(monkeypatch, capsys, *words: str) -> tuple[int, str, str]:
    """Exit code and streams of the command, in this process."""
    monkeypatch.setattr(sys, "argv", ["scancell", *words])
    monkeypatch.setattr(cli.signal, "signal", lambda *_: None)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    streams = capsys.readouterr()
    return int(ended.value.code or 0), streams.out, streams.err


def run(work, as_json: bool) -> int:
    try:
        common.run("test", as_json, work)
    except common.typer.Exit as ended:
        return int(ended.exit_code)
    return 0


def fail(error: BaseException):
    def work() -> common.Outcome:
        raise error

    return work


DONE = common.Outcome(["a line"], {"points": 3}, ["a file"], ["take care"], {"load": 0.5})


def test_people_read_the_text_on_standard_output(capsys) -> None:
    assert run(lambda: DONE, as_json=False) == 0
    streams = capsys.readouterr()
    assert streams.out == "a line\n"
    assert streams.err == "warning: take care\n"


def test_programs_read_one_object_and_nothing_else(capsys) -> None:
    assert run(lambda: DONE, as_json=True) == 0
    streams = capsys.readouterr()
    assert json.loads(streams.out) == {
        "command": "test",
        "ok": True,
        "figures": {"points": 3},
        "files": ["a file"],
        "warnings": ["take care"],
        "timings": {"load": 0.5},
    }
    assert streams.err.splitlines() == ["a line", "warning: take care"]


@pytest.mark.parametrize("error", [ScancellError("broken"), MeshError("broken")])
def test_own_errors_become_a_message_and_code_1(capsys, error) -> None:
    assert run(fail(error), as_json=True) == 1
    streams = capsys.readouterr()
    assert streams.err == "scancell: broken\n"
    told = json.loads(streams.out)
    assert told == {"command": "test", "ok": False, "error": {"kind": type(error).__name__, "message": "broken"}}


def test_interrupt_becomes_code_130(capsys) -> None:
    assert run(fail(KeyboardInterrupt()), as_json=False) == 130
    streams = capsys.readouterr()
    assert streams.out == ""
    assert streams.err == "scancell: interrupted\n"


def test_a_fault_of_the_program_is_not_hidden() -> None:
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
def test_wrong_command_line_is_told_in_json_too(monkeypatch, capsys, words, command) -> None:
    code, out, err = call(monkeypatch, capsys, *words)
    assert code == 2
    assert "Usage" in err
    told = json.loads(out)
    assert told["command"] == command
    assert told["error"]["kind"] == "UsageError"
    assert told["error"]["message"] in err


def test_wrong_command_line_without_json_keeps_standard_output_clean(monkeypatch, capsys) -> None:
    code, out, err = call(monkeypatch, capsys, "scan")
    assert (code, out) == (2, "")
    assert "Missing argument" in err


def test_version(monkeypatch, capsys) -> None:
    code, out, _ = call(monkeypatch, capsys, "version", "--json")
    assert code == 0
    assert json.loads(out)["figures"]["versions"]["python"].startswith("3.")


@pytest.mark.parametrize("text", ["1,2,3", "", "1,2,3,4,5,x", "1,2,3,4,5,inf", "1,2,3,4,5,6,7"])
def test_six_numbers_are_six_numbers(text) -> None:
    with pytest.raises(ScancellError, match="--pose"):
        cli._numbers(text, 6, "--pose")


def test_numbers_may_have_signs_and_spaces() -> None:
    assert cli._numbers("1, -2,3e1,0,0,.5", 6, "--pose") == (1.0, -2.0, 30.0, 0.0, 0.0, 0.5)
