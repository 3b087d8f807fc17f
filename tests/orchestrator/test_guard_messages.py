"""Messages between cell and guard: round trips, and what is refused."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bench.guard_packets import Traffic, random_answer, random_state, run_in_process
from guard_answers import JointLimitGuard, state_at
from scancell.cell.driver import Mode, Operation
from scancell.errors import MessageError
from scancell.guard.endpoints import REJECTED, SILENCE, SUPERSEDED, CellEndpoint, GuardEndpoint, Outcome
from scancell.guard.messages import MAX_PACKET, CellState, GuardMessage, PlacedPart, axes_digest, decode
from scancell.guard.transport import PacketStream

SESSION, GUARD = 0x0123456789ABCDEF, 2**64 - 1
ANSWER = GuardMessage(3, 7, 1.25, 0.5, True, "joint 1 → wall 20 mm", True)


def sealed(packet: bytes, at: int, new: bytes) -> bytes:
    """A packet with bytes replaced and the right CRC-32."""
    changed = packet[:at] + new + packet[at + len(new) : -4]
    return changed + struct.pack("<I", zlib.crc32(changed))


def test_messages_survive_the_round_trip():
    rng = np.random.default_rng(1)
    for _ in range(300):
        for message in (random_state(rng, 5), random_answer(rng, 5, 7, 0.2)):
            packet = message.encode(SESSION, GUARD)
            found = decode(packet)
            assert (found.session, found.guard, type(found.message)) == (SESSION, GUARD, type(message))
            assert found.message.encode(SESSION, GUARD) == packet
            for name in message.__dataclass_fields__:
                np.testing.assert_array_equal(getattr(found.message, name), getattr(message, name))


def largest_state() -> CellState:
    axes = np.full(16, -1e4)
    return CellState(
        2**32 - 1, 1e9, Operation.AUTOMATIC, Mode.SERVO, True, axes, 0.0, np.tile(axes, (64, 1)), 10.0,
        widths=np.full(4, 0.1), parts=tuple(PlacedPart(k, 16, (1, 2, 3, 0, 0, 1, 0)) for k in range(1, 9)),
        prismatic=2**16 - 1, digest=2**32 - 1,
    )  # fmt: skip


def test_states_of_version_1_are_read_and_answered_in_version_1():
    """Bytes as documented: joints and a table, no kinds, grippers or parts."""
    state = replace(state_at(5, 0.3), version=1)
    body = struct.pack("<ddddBBBBH7d", state.time, 1.0, 0.0, 0.0, 0, 4, 1, 6, 0, *state.axes)
    packet = struct.pack("<4sBBHQQI", b"SCGD", 1, 1, 126, SESSION, 0, 5) + body
    assert state.encode(SESSION, 0) == packet + struct.pack("<I", zlib.crc32(packet))
    end, cell = GuardEndpoint(JointLimitGuard()), CellEndpoint(age_limit=0.1)
    assert end.receive(cell.packet(state), state.time)
    answer = end.answer()
    assert answer is not None
    assert decode(answer).version == 1
    assert cell.receive(answer, state.time) is not None
    assert not end.receive(replace(state_at(6), sequence=6).encode(decode(answer).session, 0), state.time)
    with pytest.raises(MessageError, match="version = 1"):
        replace(state, digest=7)


def test_digest_states_names_and_kinds_of_the_axes():
    names = ["q[1]", "q[2]", "table"]
    assert axes_digest(names) == zlib.crc32(b"q[1] revolute\nq[2] revolute\ntable revolute\n")
    assert len({axes_digest(names), axes_digest(names[::-1]), axes_digest(names, 4), axes_digest(names[:2])}) == 4


def test_largest_and_smallest_state():
    large = largest_state()
    packet = large.encode(SESSION, 0)
    assert len(packet) == MAX_PACKET
    np.testing.assert_array_equal(decode(packet).message.ahead, large.ahead)
    small = CellState(0, -1e9, Operation.MANUAL, Mode.HOLD, False, [0.0, 0.0])
    assert decode(small.encode(1, 0)).message.ahead.shape == (0, 2)


@pytest.mark.parametrize("message", [state_at(5, 0.3), ANSWER], ids=["state", "answer"])
def test_every_bit_flip_and_truncation_is_refused(message):
    packet = message.encode(SESSION, GUARD)
    for bit in range(8 * len(packet)):
        flipped = bytearray(packet)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(MessageError, match="expected"):
            decode(bytes(flipped))
    for length in range(len(packet)):
        with pytest.raises(MessageError, match="expected"):
            decode(packet[:length])
    with pytest.raises(MessageError, match="expected"):
        decode(packet + b"\0")


STATE, REPLY = state_at(5, 0.3).encode(SESSION, 0), ANSWER.encode(SESSION, GUARD)


@pytest.mark.parametrize(
    ("packet", "at", "new"),
    [
        (STATE, 4, b"\3"),  # version
        (STATE, 4, b"\1"),  # a state of version 2 is none of version 1
        (STATE, 5, b"\3"),  # kind
        (STATE, 5, b"\2"),  # a state is no answer
        (STATE, 8, bytes(8)),  # session 0
        (STATE, 28, struct.pack("<d", np.nan)),  # time
        (STATE, 28, struct.pack("<d", 2e9)),
        (STATE, 36, struct.pack("<d", 1.5)),  # rate
        (STATE, 36, struct.pack("<d", -0.5)),
        (STATE, 44, struct.pack("<d", 0.1)),  # spacing without a path ahead
        (STATE, 52, struct.pack("<d", 0.1)),  # time of a path without a path ahead
        (STATE, 60, b"\2"),  # operation
        (STATE, 61, b"\7"),  # mode
        (STATE, 62, b"\4"),  # flags
        (STATE, 63, b"\1"),  # axes
        (STATE, 63, b"\6"),
        (STATE, 63, b"\x11"),
        (STATE, 64, b"\1\0"),  # rows of the path ahead
        (STATE, 64, b"\xff\xff"),
        (STATE, 71, b"\1"),  # kind of an axis that there is not
        (STATE, 74, b"\5"),  # grippers
        (STATE, 75, b"\x09"),  # parts
        (STATE, 76, struct.pack("<d", np.inf)),  # an axis
        (STATE, 76, struct.pack("<d", 1e5)),
        (REPLY, 5, b"\1"),  # an answer is no state
        (REPLY, 32, struct.pack("<d", -np.inf)),  # time of the state
        (REPLY, 40, struct.pack("<d", 1.01)),  # monitor speed
        (REPLY, 40, struct.pack("<d", np.nan)),
        (REPLY, 48, b"\2"),  # emergency stop
        (REPLY, 49, b"\xff"),  # beep
        (REPLY, 50, b"\x01"),  # length of the text
        (REPLY, 51, b"\xff"),  # not UTF-8
        (REPLY, 51, b"\x1b"),  # not printable
    ],
)
def test_wrong_values_are_refused_though_the_crc_is_right(packet, at, new):
    decode(sealed(packet, at, packet[at : at + len(new)]))
    with pytest.raises(MessageError, match="expected"):
        decode(sealed(packet, at, new))


@pytest.mark.parametrize(
    "changes",
    [
        {"axes": [0.0]},
        {"axes": np.zeros(17)},
        {"widths": np.zeros(5)},
        {"widths": [np.nan]},
        {"prismatic": 2**7},
        {"digest": -1},
        {"parts": (PlacedPart(1, 8, (0, 0, 0, 1, 0, 0, 0)),)},  # of an axis that there is not
        {"parts": (PlacedPart(1, 0, (0, 0, 0, 1, 0, 0, 0)),) * 2},
        {"version": 3},
        {"axes": np.zeros((2, 3))},
        {"ahead": np.zeros((65, 7)), "spacing": 0.1},
        {"ahead": np.zeros((2, 6)), "spacing": 0.1},
        {"ahead": np.zeros((2, 7))},
        {"spacing": 0.1},
        {"ahead": np.zeros((2, 7)), "spacing": 5e-324},
        {"ahead": np.zeros((2, 7)), "spacing": 9.9e-4},
        {"ahead": np.zeros((2, 7)), "spacing": 10.1},
        {"ahead": np.zeros((2, 7)), "spacing": np.nan},
        {"ahead": np.zeros((2, 7)), "spacing": 0.1, "path_time": 0.1},  # later than the state
        {"ahead": np.zeros((2, 7)), "spacing": 0.1, "path_time": np.nan},
        {"path_time": -0.1},
        {"sequence": -1},
        {"sequence": 2**32},
        {"time": np.nan},
    ],
)
def test_states_outside_the_bounds_cannot_be_made(changes):
    with pytest.raises(MessageError, match="expected"):
        replace(state_at(0), **changes)


@pytest.mark.parametrize("text", ["x" * 121, "é" * 61, "two\nlines", "\ud800"])
def test_texts_outside_the_bounds_cannot_be_made(text):
    with pytest.raises(MessageError, match="text"):
        replace(ANSWER, text=text)


def connected() -> tuple[CellEndpoint, GuardEndpoint, JointLimitGuard]:
    """Endpoints that have exchanged state 0."""
    guard = JointLimitGuard()
    ends = CellEndpoint(age_limit=0.1), GuardEndpoint(guard)
    assert exchanged(*ends, 0)
    return *ends, guard


def exchanged(cell: CellEndpoint, end: GuardEndpoint, sequence: int) -> bool:
    """Whether a state is answered, and the answer accepted."""
    state = state_at(sequence)
    if not end.receive(cell.packet(state), state.time):
        return False
    answer = end.answer()
    return answer is not None and cell.receive(answer, state.time) is not None


def test_sequence_numbers_wrap_around():
    cell, end, _ = connected()
    for sequence in (2**31 - 1, 2**32 - 2, 2**32 - 1, 2**32, 2**32 + 5):
        assert exchanged(cell, end, sequence)
    assert end.counts == cell.counts == {Outcome.ACCEPTED: 6}
    assert not exchanged(cell, end, 2**32 + 4)
    assert end.counts[Outcome.OLD] == 1


def test_duplicates_old_and_stale_messages_are_refused_and_counted():
    cell, end, guard = connected()
    packets = [cell.packet(state_at(i)) for i in range(1, 5)]
    answers = []
    for i in (0, 2):
        assert end.receive(packets[i], 0.0)
        answers.append(end.answer())
    assert [end.receive(packets[i], 0.0) for i in (2, 1, 0)] == [False] * 3
    assert end.answer() is None
    assert end.counts == {Outcome.ACCEPTED: 3, Outcome.DUPLICATE: 1, Outcome.OLD: 2}
    assert [state.sequence for state in guard.states] == [0, 1, 3]

    now = state_at(3).time
    assert cell.receive(answers[1], now + 0.101) is None  # a refused answer changes nothing
    assert cell.receive(answers[1], now + 0.099).state_sequence == 3
    assert cell.age(now + 0.02) == pytest.approx(0.02)
    assert [cell.receive(answers[i], now) for i in (1, 0)] == [None, None]
    assert cell.receive(packets[0], now) is None
    assert not end.receive(answers[1], 0.0)
    assert cell.counts == {
        Outcome.ACCEPTED: 2, Outcome.STALE: 1, Outcome.DUPLICATE: 1, Outcome.OLD: 1, Outcome.WRONG_KIND: 1,
    }  # fmt: skip
    assert end.counts[Outcome.WRONG_KIND] == 1


def test_state_measured_before_the_last_one_is_refused():
    cell, end, _ = connected()
    assert exchanged(cell, end, 2)
    assert not end.receive(cell.packet(replace(state_at(1), sequence=3)), 0.0)
    assert not end.receive(cell.packet(replace(state_at(2), sequence=3, time=state_at(2).time + 9e-5)), 0.0)
    assert end.counts[Outcome.TIME_NOT_LATER] == 2
    assert end.receive(cell.packet(replace(state_at(2), sequence=4, time=state_at(2).time + 1.1e-4)), 0.0)


def test_answers_to_states_that_were_not_sent_are_refused():
    cell, end, _ = connected()
    assert end.receive(cell.packet(state_at(1)), 0.0)
    good = end.answer()
    session, number = decode(good).session, decode(good).guard
    for wrong in ({"state_sequence": 2}, {"state_time": 0.033}):
        forged = replace(decode(good).message, **wrong)
        assert cell.receive(forged.encode(session, number), 0.05) is None
    assert cell.counts[Outcome.UNKNOWN_STATE] == 2
    assert cell.receive(good, 0.05) is not None


def test_only_the_newest_of_waiting_states_is_answered():
    cell, end, guard = connected()
    for i in (1, 2, 3):
        assert end.receive(cell.packet(state_at(i)), 0.0)
    assert cell.receive(end.answer(), state_at(3).time).state_sequence == 3
    assert end.answer() is None
    assert end.counts[SUPERSEDED] == 2
    assert [state.sequence for state in guard.states] == [0, 3]


def test_state_of_another_arm_gets_no_answer():
    cell, end, _ = connected()
    assert end.receive(cell.packet(replace(state_at(1), axes=np.zeros(8))), 0.0)
    assert end.answer() is None
    assert end.counts[REJECTED] == 1
    assert exchanged(cell, end, 2)


def test_restarted_guard_answers_only_after_a_reset():
    cell, _, _ = connected()
    opening = decode(cell.packet(state_at(0))).session
    restarted = GuardEndpoint(JointLimitGuard())
    assert not any(exchanged(cell, restarted, i) for i in range(1, 50))
    assert restarted.counts == {Outcome.OTHER_SESSION: 49}
    # A packet that opened the old session comes late: the new guard's answers do not count.
    late = state_at(50)
    assert restarted.receive(late.encode(opening, 0), 0.0)
    assert cell.receive(restarted.answer(), late.time) is None
    assert cell.age(late.time) == pytest.approx(late.time)
    cell.reset()
    assert cell.age(1.7) == np.inf
    assert exchanged(cell, restarted, 100)  # 3.2 s: the session that opened late is silent


def test_new_session_waits_until_the_guard_is_free():
    cell, end, guard = connected()
    other = CellEndpoint(age_limit=0.1)
    assert not end.receive(other.packet(state_at(1)), SILENCE - 0.01)
    assert end.counts[Outcome.BUSY] == 1
    assert end.receive(cell.packet(state_at(1)), SILENCE - 0.005)
    left = end.answer()
    assert end.receive(other.packet(state_at(1)), 2 * SILENCE)
    assert other.receive(end.answer(), state_at(1).time) is not None
    assert guard.resets == 2
    assert [state.sequence for state in guard.states] == [1]
    # What is left of the session before does not count any more.
    assert other.receive(left, state_at(1).time) is None
    assert not end.receive(cell.packet(state_at(2)), 9.0)
    assert not end.receive(state_at(3).encode(decode(left).session, 0), 9.0)
    assert end.counts[Outcome.OTHER_SESSION] == 2


def test_packets_of_a_stream_in_pieces():
    rng = np.random.default_rng(2)
    packets = [random_state(rng, i).encode(SESSION, 0) for i in range(50)]
    whole = b"".join(packets)
    cuts = [0, *sorted(rng.integers(0, len(whole), 200)), len(whole)]
    stream = PacketStream()
    pieces = [whole[start:end] for start, end in pairwise(cuts)]
    assert [packet for piece in pieces for packet in stream.packets(piece)] == packets
    with pytest.raises(MessageError, match="magic"):
        list(stream.packets(b"GET / HTTP/1.1"))


def test_random_and_mutated_packets_are_refused():
    counts = Counter()
    run_in_process(Traffic(seed=3), 5000, counts)
    assert counts["accepted mutants"] == 0
    assert counts["mutants"] == 5000
    assert counts["accepted genuine packets"] == counts["genuine packets"] > 100
