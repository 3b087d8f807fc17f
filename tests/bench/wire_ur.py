"""The simulated UR over RTDE: ``python -m bench.wire_ur [--minutes M] [--real SECONDS] [--packets N]``.

PYTHONPATH=tests:tests/orchestrator. A client of our own receives every cycle of simulated time while the robot moves to
and fro; in real time the share of cycles that began more than a cycle late; mutants of packets over TCP, after each of
which an honest client is answered.
"""

from __future__ import annotations

import argparse
import socket
import time

import numpy as np

from scancell.wire.ur.client import RtdeClient
from scancell.wire.ur.controller import UrController
from wire_ur import NAMES, controller_of, mutated, own_address, packets, served


def to_and_fro(controller: UrController, times: int) -> None:
    home = controller.robot.home
    lines = [f"  movej({(home + shift).tolist()}, v=1.0)" for _ in range(times) for shift in (0.3, -0.3)]
    controller.run_script("def f():\n" + "\n".join(lines) + "\nend")


def simulated(minutes: float) -> None:
    with (
        controller_of() as controller,
        served(controller) as (rtde, _, _, server),
        RtdeClient(own_address(), server.ports[rtde]) as client,
    ):
        to_and_fro(controller, round(60 * minutes))
        client.set_outputs(NAMES, 500.0)
        begin = time.monotonic()
        client.start()
        stamps: list[float] = []
        while not stamps or stamps[-1] - stamps[0] < 60 * minutes:
            stamps += [package["timestamp"][0] for package in client.receive(5.0)]
        took = time.monotonic() - begin
    lost = np.rint(np.diff(stamps) / controller.cycle).astype(int) - 1
    print(f"simulated: {len(stamps)} packages of {minutes:g} min, {lost.sum()} cycles lost, in {took:.1f} s")


def real(seconds: float) -> None:
    with (
        controller_of() as controller,
        served(controller, realtime=True) as (rtde, _, _, server),
        RtdeClient(own_address(), server.ports[rtde]) as client,
    ):
        to_and_fro(controller, round(seconds))
        client.set_outputs(NAMES, 500.0)
        client.start()
        stamps: list[float] = []
        arrived: list[float] = []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for package in client.receive(1.0):
                stamps.append(package["timestamp"][0])
                arrived.append(time.monotonic())
    gaps = np.diff(arrived)
    lost = np.rint(np.diff(stamps) / controller.cycle).astype(int) - 1
    timing = server.timing
    late = f"{timing.late} of {timing.cycles} cycles ({timing.late / timing.cycles:.2%}) began more than a cycle late"
    middle, most = 1e3 * np.quantile(gaps, [0.5, 0.999])
    print(
        f"real: {len(stamps)} packages in {seconds:g} s, {lost.sum()} lost; {late}; gaps of the client: median "
        f"{middle:.2f} ms, 99.9 % {most:.2f} ms, largest {1e3 * gaps.max():.1f} ms"
    )


def wrong_packets(number: int) -> None:
    rng, honest = np.random.default_rng(1), packets()
    answered = connections = 0
    with controller_of() as controller, served(controller) as (rtde, _, _, server):
        address = (own_address(), server.ports[rtde])
        for start in range(0, number, 100):
            for first in range(start, min(start + 100, number), 20):
                with socket.create_connection(address, 5.0) as connection:
                    connections += 1
                    connection.settimeout(5.0)
                    for packet in honest[: int(rng.integers(6))]:
                        connection.sendall(packet)
                    try:
                        for i in range(first, first + 20):
                            connection.sendall(mutated(honest[i % len(honest)], rng))
                    except OSError:  # closed by the server
                        pass
            with RtdeClient(*address) as client:
                client.set_outputs(NAMES, 500.0)
                client.start()
                answered += bool(client.receive(5.0))
        refused = controller.refusals["RTDE"]
    checks = -(-number // 100)
    print(
        f"packets: {number} mutants on {connections} connections, {refused} refused; {answered} of {checks} honest "
        "clients served in between"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--real", type=float, default=0.0)
    parser.add_argument("--packets", type=int, default=0)
    options = parser.parse_args()
    if options.minutes:
        simulated(options.minutes)
    if options.real:
        real(options.real)
    if options.packets:
        wrong_packets(options.packets)
