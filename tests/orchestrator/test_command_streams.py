"""The command line with names that are not UTF-8, a full standard output, and as a module."""

import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-m", "scancell"]


@pytest.mark.parametrize("arguments", [[b"scan", b"p\xe4rt.stl"], [b"scan", b"ok.stl", b"--out=\xe4out"]])
def test_names_that_are_not_utf8_are_refused_at_once(tmp_path, arguments):
    done = subprocess.run([*COMMAND, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("scancell: '")
    assert done.stderr.endswith("is not UTF-8: rename the file or folder\n")
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("arguments", [["version"], ["--help"], ["version", "--json"]])
def test_full_standard_output_is_an_error_without_traceback(arguments):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*COMMAND, *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert "the output cannot be written: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
