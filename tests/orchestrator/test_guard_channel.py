"""The channel against closed forms, and links through it."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import kstest

from guard_answers import JointLimitGuard, state_at
from scancell.config.cell import ChannelDescription, LinkDescription
from scancell.guard.endpoints import SUPERSEDED, Outcome
from scancell.guard.transport import Arrival, Channel, InProcess, Link, faulty_link

PERIOD = 0.032
PACKETS = 20_000
SIGMAS = 5.0
ENDLESS = 1e9


def number(arrival: Arrival) -> int:
    return int.from_bytes(arrival.packet, "little")


def sent_through(packets: int = PACKETS, seed: int = 1, **description) -> tuple[Channel, list[Arrival]]:
    """Arrivals of packets 0, 1, 2, ... that were sent one a period."""
    channel = Channel(ChannelDescription(**description), seed)
    for i in range(packets):
        channel.send(i.to_bytes(4, "little"), i * PERIOD)
    return channel, channel.receive(ENDLESS)


def assert_rate(count: int, expected: float, packets: int = PACKETS, correlation: float = 0.0) -> None:
    """Within five standard deviations of a share; `correlation` of successive packets (geometric) widens them."""
    wider = (1 + correlation) / (1 - correlation)
    deviation = math.sqrt(expected * (1 - expected) / packets * wider)
    assert count / packets == pytest.approx(expected, abs=SIGMAS * deviation)


def test_channel_without_faults_delivers_at_once_and_in_order():
    channel = Channel(ChannelDescription(), 1)
    for i in range(100):
        channel.send(i.to_bytes(4, "little"), i * PERIOD)
        assert [(number(a), a.time) for a in channel.receive(i * PERIOD)] == [(i, i * PERIOD)]
    assert channel.counts == {"sent": 100}


def test_packet_arrives_after_its_delay_and_not_before():
    channel = Channel(ChannelDescription(delay_ms=20), 1)
    channel.send(b"a", 1.0)
    assert channel.receive(1.0199) == []
    assert [arrival.packet for arrival in channel.receive(1.0201)] == [b"a"]
    assert channel.receive(ENDLESS) == []


def test_delays_are_distributed_as_described():
    _, arrivals = sent_through(delay_ms=5, jitter_ms=12)
    delays = np.array([arrival.time - number(arrival) * PERIOD for arrival in arrivals])
    assert delays.mean() == pytest.approx(0.017, abs=SIGMAS * 0.012 / math.sqrt(PACKETS))
    assert kstest(delays, "expon", args=(0.005, 0.012)).pvalue > 1e-4


def test_packets_overtake_each_other_as_often_as_exponential_delays_do():
    """P(d_i > PERIOD + d_j) = exp(-PERIOD / jitter) / 2 for independent exponential d_i, d_j."""
    jitter = 0.05
    _, arrivals = sent_through(jitter_ms=1e3 * jitter)
    time = np.empty(PACKETS)
    for arrival in arrivals:
        time[number(arrival)] = arrival.time
    swapped = int((np.diff(time)[::2] < 0).sum())
    assert_rate(swapped, math.exp(-PERIOD / jitter) / 2, PACKETS // 2)
    assert all(before.time <= after.time for before, after in pairwise(arrivals))


@pytest.mark.parametrize("loss", [0.01, 0.3])
def test_independent_losses(loss):
    channel, arrivals = sent_through(loss=loss)
    assert channel.counts["lost"] == PACKETS - len(arrivals)
    assert_rate(channel.counts["lost"], loss)


@pytest.mark.parametrize(("burst", "length"), [(0.01, 8.0), (0.1, 3.0)])
def test_bursts_of_losses(burst, length):
    """Share of time in bursts p / (p + r), lengths geometric with mean 1 / r."""
    channel, arrivals = sent_through(burst=burst, burst_packets=length)
    share = burst / (burst + 1 / length)
    assert_rate(channel.counts["lost"], share, correlation=1 - burst - 1 / length)
    gaps = np.diff([number(arrival) for arrival in arrivals])
    bursts = gaps[gaps > 1] - 1
    deviation = math.sqrt(length * (length - 1) / len(bursts))
    assert bursts.mean() == pytest.approx(length, abs=SIGMAS * deviation)
    assert len(bursts) > 100


def test_losses_inside_and_outside_of_bursts():
    channel, _ = sent_through(loss=0.02, burst=0.02, burst_packets=5, burst_loss=0.6)
    share = 0.02 / (0.02 + 0.2)
    assert_rate(channel.counts["lost"], share * 0.6 + (1 - share) * 0.02, correlation=1 - 0.22)


def test_duplicates_have_delays_of_their_own():
    channel, arrivals = sent_through(duplication=0.1, jitter_ms=10)
    assert len(arrivals) == PACKETS + channel.counts["duplicated"]
    assert_rate(channel.counts["duplicated"], 0.1)
    times: dict[int, list[float]] = {}
    for arrival in arrivals:
        times.setdefault(number(arrival), []).append(arrival.time)
    apart = [pair[1] - pair[0] for pair in times.values() if len(pair) == 2]
    assert kstest(apart, "expon", args=(0, 0.010)).pvalue > 1e-4  # |d_i - d_j| is exponential, too


def test_replayed_packets_come_again_later():
    channel, arrivals = sent_through(replay=0.05, replay_ms=700, delay_ms=3)
    assert_rate(channel.counts["replayed"], 0.05)
    late = [arrival.time - number(arrival) * PERIOD for arrival in arrivals]
    assert np.allclose(sorted(late)[-channel.counts["replayed"] :], 0.703)
    assert sorted(late)[-channel.counts["replayed"] - 1] == pytest.approx(0.003)


def test_dead_link_delivers_nothing_until_it_works_again():
    channel, arrivals = sent_through(500, dead_from_s=3.0, dead_until_s=8.0, delay_ms=10)
    assert not [arrival for arrival in arrivals if 3.0 <= arrival.time < 8.0]
    assert {number(arrival) for arrival in arrivals} == {
        i for i in range(500) if i * PERIOD + 0.01 < 3.0 or i * PERIOD >= 8.0
    }
    assert channel.counts["lost"] == 500 - len(arrivals)
    assert sent_through(500, dead_from_s=3.0)[1][-1].time < 3.0


def test_faults_are_reproducible_by_seed_and_independent_of_each_other():
    faults = {"delay_ms": 5, "jitter_ms": 10, "loss": 0.05, "burst": 0.01, "duplication": 0.05, "replay": 0.05}
    first, again, other = (sent_through(2000, seed, **faults)[1] for seed in (7, 7, 8))
    assert first == again
    assert first != other
    calm = sent_through(2000, 7, **{**faults, "duplication": 0.0, "replay": 0.0})[1]
    assert {(a.time, a.packet) for a in calm} < {(a.time, a.packet) for a in first}


def run(link: Link, guard: JointLimitGuard, polls: int = 600, limit: float = 0.1) -> list[int]:
    """Polls with a state each; the numbers of those that were answered. What must hold in any network is asserted."""
    answered: list[int] = []
    for i in range(polls):
        now = i * PERIOD
        link.send(state_at(i, angle=1e-3 * i), now)
        for answer in link.poll(now):
            assert not answered or answer.state_sequence > answered[-1]
            answered.append(answer.state_sequence)
            assert (answer.text != "") == (1e-3 * answer.state_sequence > 0.5)
        if answered:
            assert link.age(now) >= 0.999 * (i - answered[-1]) * PERIOD
    numbers = [state.sequence for state in guard.states]
    times = [state.time for state in guard.states]
    assert numbers == sorted(set(numbers))
    assert times == sorted(set(times))
    return answered


FAULTS = {
    "delay": {"to_guard": {"delay_ms": 20}, "to_cell": {"delay_ms": 10}},
    "jitter": {"to_guard": {"jitter_ms": 20}, "to_cell": {"jitter_ms": 40}},
    "loss": {"to_guard": {"loss": 0.3}, "to_cell": {"loss": 0.3}},
    "bursts": {"to_guard": {"burst": 0.05}, "to_cell": {"burst": 0.05}},
    "duplication": {
        "to_guard": {"duplication": 0.5, "jitter_ms": 40},
        "to_cell": {"duplication": 0.5, "jitter_ms": 40},
    },
    "replay": {"to_guard": {"replay": 0.5}, "to_cell": {"replay": 0.5}},
    "clock": {"clock_offset_ms": -7e6, "clock_drift_ppm": 300},
    "stale": {"stale": 0.3, "stale_polls": 3},
    "dead": {"to_guard": {"dead_from_s": 5.0, "dead_until_s": 9.0}},
}
REFUSED = {
    "jitter": (Outcome.OLD, Outcome.STALE),
    "duplication": (Outcome.DUPLICATE, Outcome.OLD, Outcome.STALE),
    "replay": (Outcome.OLD,),
    "stale": (Outcome.TIME_NOT_LATER,),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_links_with_faults_keep_order_and_age(fault):
    guard = JointLimitGuard()
    transport = InProcess(guard)
    link = faulty_link(transport, LinkDescription(**FAULTS[fault]), age_limit=0.1, seed=5)
    answered = run(link, guard)
    refusals = (link.counts + transport.endpoint.counts).keys() - {Outcome.ACCEPTED}
    assert refusals == set(REFUSED.get(fault, ()))
    assert len(answered) > (250 if fault != "dead" else 0)
    if fault == "clock":
        assert answered == list(range(600))
    if fault == "dead":
        assert answered == [i for i in range(600) if not 5.0 <= i * PERIOD < 9.0]


def test_age_grows_while_the_link_is_dead():
    guard = JointLimitGuard()
    faults = LinkDescription(to_cell={"dead_from_s": 1.0})
    link = faulty_link(InProcess(guard), faults, age_limit=0.1, seed=5)
    last = run(link, guard, 100)[-1]
    assert last == 31
    assert link.age(3.2) == pytest.approx(3.2 - last * PERIOD)


def test_answers_come_after_the_time_of_computation():
    """A guard that computes for 70 ms is free at multiples of it, and answers the newest state of that time."""
    guard = JointLimitGuard()
    transport = InProcess(guard, compute_time=0.070)
    link = Link(transport, age_limit=0.2)
    answered = run(link, guard, 30)
    assert answered == [int(k * 0.070 / PERIOD) for k in range(13)]  # the next one is not ready
    assert transport.endpoint.counts == {Outcome.ACCEPTED: 29, SUPERSEDED: 29 - 14}
    assert link.age(29 * PERIOD) == pytest.approx((29 - answered[-1]) * PERIOD)


def test_faults_of_the_clock_do_not_change_the_age():
    """Ages are differences of the controller's clock: an offset has no effect, a drift the relative one."""
    guard = JointLimitGuard()
    faults = LinkDescription(clock_offset_ms=3.6e6, clock_drift_ppm=1000, to_cell={"dead_from_s": 0.01})
    link = faulty_link(InProcess(guard), faults, age_limit=0.1, seed=5)
    run(link, guard, 2)
    assert link.age(5.0) == pytest.approx(5.0 * 1.001)
    assert [state.time for state in guard.states] == pytest.approx([3600.0, 3600.0 + 1.001 * PERIOD])


def test_time_of_a_path_is_that_of_the_same_clock_as_the_state():
    guard = JointLimitGuard()
    faults = LinkDescription(clock_offset_ms=3.6e6, clock_drift_ppm=1000)
    link = faulty_link(InProcess(guard), faults, age_limit=0.1, seed=5)
    link.send(replace(state_at(5), ahead=np.zeros((1, 7)), spacing=PERIOD, path_time=4 * PERIOD), 5 * PERIOD)
    assert link.poll(5 * PERIOD)
    assert guard.states[0].path_time == pytest.approx(3600.0 + 1.001 * 4 * PERIOD)


def test_reset_opens_a_session_with_a_restarted_guard():
    first, second = JointLimitGuard(), JointLimitGuard()
    link = Link(transport := InProcess(first), age_limit=0.1)
    assert len(run(link, first, 10)) == 10
    transport.endpoint = InProcess(second).endpoint
    for i in range(10, 40):
        link.send(state_at(i), i * PERIOD)
        assert link.poll(i * PERIOD) == []
    assert second.states == []
    link.reset()
    link.send(state_at(40), 40 * PERIOD)
    assert [answer.state_sequence for answer in link.poll(40 * PERIOD)] == [40]
