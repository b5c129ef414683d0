"""One slot between threads: the newest value, once, and a count of those nobody took."""

import threading
import time

from follower_vision.mailbox import Mailbox


def test_the_newest_value_wins_and_the_others_are_counted():
    box: Mailbox[int] = Mailbox()
    for value in (1, 2, 3):
        box.put(value)
    assert box.wait(0) == 3
    assert (box.received, box.overwritten) == (3, 2)


def test_a_value_is_taken_once_but_stays_the_newest():
    box: Mailbox[int] = Mailbox()
    box.put(7)
    assert box.wait(0) == 7
    assert box.wait(0) is None
    assert box.newest == 7
    box.put(8)
    assert box.overwritten == 0


def test_waiting_ends_when_a_value_comes():
    box: Mailbox[str] = Mailbox()
    threading.Timer(0.05, box.put, ["frame"]).start()
    assert box.wait(60) == "frame"


def test_waiting_ends_after_the_time_out():
    before = time.monotonic()
    assert Mailbox[int]().wait(0.05) is None
    assert 0.04 < time.monotonic() - before < 2


def test_closing_lets_waiting_threads_go_and_keeps_the_last_value():
    box: Mailbox[int] = Mailbox()
    threading.Timer(0.05, box.close).start()
    assert box.wait() is None
    assert box.closed
    full: Mailbox[int] = Mailbox()
    full.put(1)
    full.close()
    full.put(2)
    assert full.wait() == 1
    assert full.wait() is None


def test_no_value_is_lost_or_given_twice_between_threads():
    box: Mailbox[int] = Mailbox()
    taken: list[int] = []

    def read() -> None:
        while (value := box.wait()) is not None:
            taken.append(value)

    reader = threading.Thread(target=read)
    reader.start()
    for value in range(2000):
        box.put(value)
    box.close()
    reader.join(60)
    assert taken == sorted(set(taken))
    assert taken[-1] == 1999
    assert len(taken) + box.overwritten == box.received == 2000
