"""What holds for all tests."""

import re
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import count

import pytest
from hypothesis import settings

# How long an example takes says nothing here: the computer may be shared.
settings.register_profile("shared computer", deadline=None)
settings.load_profile("shared computer")

_SLEEP_S = 0.005
_FIRST_PORT, _LAST_PORT = 20_000, 32_000  # below those that Linux gives to port 0


@pytest.fixture(scope="session")
def free_port() -> Iterator[Callable[[], int]]:
    """Return ports for what cannot be given port 0, each to one test of this computer.

    A name in the abstract socket namespace stands for a port until the test process has ended, so
    that two runs, or two workers of one, never share it.
    """
    held: list[socket.socket] = []
    numbers = count(_FIRST_PORT)

    def reserve() -> int:
        for port in numbers:
            assert port <= _LAST_PORT, "no port is free"
            claim = socket.socket(socket.AF_UNIX)
            try:
                claim.bind(f"\0follower-test-port-{port}")
            except OSError:
                claim.close()
                continue
            held.append(claim)
            if _is_free(port):
                return port
        raise AssertionError

    yield reserve
    for claim in held:
        claim.close()


def _is_free(port: int) -> bool:
    """Whether no other program has it, by UDP or TCP."""
    for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True


@pytest.fixture
def late_s() -> Iterator[Callable[[], float]]:
    """Return by how much this computer has been too late in this test, in seconds.

    A thread that sleeps 5 ms measures it. What is promised within some real time can be judged on
    a busy computer too: its bound is the promised time and this.
    """
    ended, longest_s = threading.Event(), 0.0

    def sleep() -> None:
        nonlocal longest_s
        before_s = time.monotonic()
        while not ended.wait(_SLEEP_S):
            now_s = time.monotonic()
            longest_s = max(longest_s, now_s - before_s - _SLEEP_S)
            before_s = now_s

    thread = threading.Thread(target=sleep, name="lateness", daemon=True)
    thread.start()
    yield lambda: longest_s
    ended.set()
    thread.join()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in one line what was skipped, and what to install."""
    reasons = Counter(_reason(report) for report in terminalreporter.stats.get("skipped", ()))
    if reasons:
        told = "; ".join(f"{number} × {reason}" for reason, number in reasons.most_common())
        terminalreporter.write_line(f"Skipped {reasons.total()} tests: {told}", yellow=True)


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    told = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return re.sub(r"^Skipped: ", "", told)
