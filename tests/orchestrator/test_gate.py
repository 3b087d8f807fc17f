"""Messages of browsers: what pages send passes, everything else is refused before viser gets it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from scancell.browser.panels.handles import report_errors
from scancell.browser.server.messages import Gate
from scancell.errors import CommandError

INPUTS = {
    "slider": SimpleNamespace(label="joint 1, deg", value=1.0, min=-10.0, max=10.0, step=0.1),
    "count": SimpleNamespace(label="speed, %", value=30, min=1, max=100, step=1),
    "free": SimpleNamespace(label="number", value=1.0, min=None, max=None),
    "choice": SimpleNamespace(label="axis", value="a", options=("a", "b")),
    "switch": SimpleNamespace(label="on", value=False),
    "text": SimpleNamespace(label="others", value=""),
    "u": SimpleNamespace(label="Open a part", value=None, mime_type=".stl"),
    "vector": SimpleNamespace(label="x, y, z", value=(0.0, 0.0, 0.0)),
}


def refusal(message: object, gate: Gate | None = None) -> str:
    return (gate or Gate(INPUTS.get)).refusal(msgspec.msgpack.encode(message))


def update(uuid: str, value: Any) -> dict[str, Any]:
    return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}


@pytest.mark.parametrize(
    ("uuid", "value"),
    [
        ("slider", -10.0),
        ("slider", 10.05),  # a page rounds to steps
        ("slider", 3),
        ("free", -1e9),
        ("choice", "b"),
        ("switch", True),
        ("text", "table.x_mm=1"),
        ("vector", [1, 2.5, -3]),
    ],
)
def test_values_that_an_input_offers_pass(uuid: str, value: Any) -> None:
    assert refusal(update(uuid, value)) == ""


@pytest.mark.parametrize(
    ("uuid", "value"),
    [
        ("slider", np.nan),
        ("slider", np.inf),
        ("slider", 10.2),
        ("slider", "nan"),
        ("slider", True),
        ("slider", None),
        ("count", 1e308),
        ("free", 2**63 - 1),
        ("free", "inf"),
        ("choice", "c"),
        ("choice", 0),
        ("switch", 1),
        ("text", 1.0),
        ("text", "x" * 20_000),
        ("vector", [1, 2]),
        ("vector", [1, 2, np.nan]),
        ("vector", ["1", "2", "inf"]),
        ("nobody's", 1.0),
    ],
)
def test_values_that_an_input_does_not_offer_are_refused(uuid: str, value: Any) -> None:
    assert refusal(update(uuid, value)) != ""


def test_clicks_on_bodies_pass() -> None:
    click = {"type": "SceneNodeClickMessage", "name": "/frames/part/part", "instance_index": None, "modifier": None}
    click |= {"ray_origin": [0.1, 0.2, 0.3], "ray_direction": [0.0, 0.6, -0.8], "screen_pos": [0.5, 0.5], "owner": ""}
    assert refusal(click) == ""
    for wrong in ({"ray_origin": [np.nan, 0, 0]}, {"ray_direction": [1, 2]}, {"name": 3}, {"more": 1}):
        assert refusal(click | wrong) != ""


def test_refusal_names_the_input_its_value_and_what_was_expected() -> None:
    assert refusal(update("slider", 11.0)) == "joint 1, deg = 11.0: expected a number from -10.1 to 10.1"
    assert refusal(update("choice", "c")) == "axis = c: expected one of a, b"


@pytest.mark.parametrize(
    "message",
    [
        {"type": "ShareUrlRequest"},
        {"type": "GuiUpdateMessage", "uuid": "slider", "updates": {"update_cb": 1}},
        {"type": "GuiUpdateMessage", "uuid": "slider", "updates": {"value": 1.0, "disabled": False}},
        {"type": "GuiUpdateMessage", "uuid": "slider"},
        {"type": "GuiButtonHoldMessage", "uuid": "slider", "frequency": np.nan},
        {"type": "TransformControlsUpdateMessage", "name": "/g", "wxyz": [1, 0, 0, np.nan], "position": [0, 0, 0]},
        [],
        1,
        "GuiUpdateMessage",
    ],
)
def test_messages_that_no_page_sends_are_refused(message: object) -> None:
    assert refusal(message) != ""


@pytest.mark.parametrize("frame", ["text", b"", b"\xc1", b"\x93\x01", b"\x81\xa4type\xa9Imaginary", b"\x91" * 10_000])
def test_frames_that_are_no_message_are_refused(frame: object) -> None:
    assert Gate(INPUTS.get).refusal(frame) != ""


def start(transfer: str, parts: int, size: int) -> dict[str, Any]:
    of = {"source_component_uuid": "u", "transfer_uuid": transfer, "filename": "a.stl", "mime_type": ""}
    return {"type": "FileTransferStartUpload", **of, "part_count": parts, "size_bytes": size}


def part(transfer: str, index: int, content: bytes) -> dict[str, Any]:
    of = {"source_component_uuid": "u", "transfer_uuid": transfer}
    return {"type": "FileTransferPart", **of, "part_index": index, "content": content}


def test_files_are_received_within_their_size_and_a_limit_for_all_that_are_begun() -> None:
    assert refusal({**start("a", 1, 5), "source_component_uuid": "choice"}) != ""
    large = Gate(INPUTS.get)
    assert refusal(start("a", 2, 2**28), large) == ""
    assert "expected at most 268 MB" in refusal(start("b", 2, 1), large)
    small = Gate(INPUTS.get)
    assert refusal(start("a", 2, 5), small) == ""
    assert refusal(start("a", 2, 5), small) != ""
    assert refusal(part("a", 2, b"1"), small) != ""
    assert refusal(part("a", 1, b"123456"), small) != ""
    assert refusal(part("a", 1, b"123"), small) == ""
    assert refusal(part("a", 1, b"12"), small) != ""
    assert refusal(part("a", 0, b"1"), small) != ""  # not all that was announced
    assert refusal(part("a", 0, b"12"), small) == ""
    assert refusal(part("a", 0, b"12"), small) != ""
    assert refusal(start("b", 2, 2**28), small) == ""  # the first one has ended
    assert refusal(start("c", 2**40, 10), small) != ""


def test_errors_of_handlers_are_reported() -> None:
    said: list[str] = []
    for error in (CommandError("expected a part"), KeyError("axis"), OverflowError("too large")):

        def act(error: Exception = error) -> None:
            raise error

        report_errors(act, said.append)
    assert said == ["expected a part", "This failed: KeyError: 'axis'", "This failed: OverflowError: too large"]
