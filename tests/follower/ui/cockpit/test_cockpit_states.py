"""The page in a real browser, a scripted flight behind it: nothing old is shown as if it were live.

And what is pressed does what it said when it was pressed.
"""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page
from waiting import until

from follower_vision.images.frame import Frame

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("chromium")]
FOLLOWING = {"state": "following", "reason": "target seen", "consent": True, "stopped": False}
RELEASED = {**FOLLOWING, "state": "released", "reason": "search failed"}


class Feed:
    """A flight's moments and frames, each of which can stand still."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self.moment: dict[str, Any] | None = FOLLOWING
        self.frames = True
        self.stuck, self.time_s = False, 0.0
        self.ended = threading.Event()

    def run(self) -> None:
        image = np.full((48, 64, 3), 90, np.uint8)
        for number in range(1_000_000):
            if self.ended.wait(0.1):
                return
            self.time_s = self.time_s if self.stuck else number / 10
            if self.moment is not None:
                self._station.show({"time_s": self.time_s, **self.moment})
            if self.frames:
                self._station.add(Frame(image, number / 10, number), (), ())


@pytest.fixture(scope="module")
def feed(served: Any) -> Iterator[Feed]:
    feed = Feed(served.station)
    thread = threading.Thread(target=feed.run)
    thread.start()
    yield feed
    feed.ended.set()
    thread.join()


@pytest.fixture
def page(browser: Browser, open_page: Any, served: Any, feed: Feed) -> Iterator[Page]:
    feed.moment, feed.frames = FOLLOWING, True
    page = open_page(browser, viewport={"width": 1280, "height": 1000})
    # Closed whatever happens, for no other page is in control as long as this one is.
    with closing(page.context):
        page.goto(served.url)
        page.wait_for_selector("#control:has-text('in control')")
        page.wait_for_selector("#state[data-state=following]")
        # Not `wait_for_function`: what that polls in the page, the page's own policy forbids.
        until(lambda: page.evaluate("seenAt !== null"))
        yield page


def asked(served: Any, kind: str) -> list[dict[str, Any]]:
    return [one for one in served.station.operator.asked if one["kind"] == kind]


@contextmanager
def one_more(served: Any, kind: str) -> Iterator[None]:
    """Expect just one more request of a kind."""
    before = len(asked(served, kind))
    yield
    until(lambda: len(asked(served, kind)) > before)
    assert len(asked(served, kind)) == before + 1


def test_a_flight_that_says_nothing_is_shown_as_silent_though_frames_come(
    page: Page, feed: Feed
) -> None:
    page.wait_for_selector("#age", state="hidden")
    feed.moment = None
    page.wait_for_selector("#age:has-text('No word from the flight')")
    for shown in ("status", "facts", "plots"):
        assert page.evaluate(f"getComputedStyle($('{shown}')).opacity") == "0.4"
    feed.moment = FOLLOWING
    until(lambda: old_parts(page) == [])


def old_parts(page: Page) -> list[str]:
    """Return what is marked as old just now, and what the bar says that tells so."""
    old = "['status', 'facts', 'plots', 'stage'].filter(one => $(one).classList.contains('old'))"
    return list(page.evaluate(f"{old}.concat($('age').hidden ? [] : [$('age').textContent])"))


def test_a_state_that_is_told_again_and_again_is_shown_as_silent(page: Page, feed: Feed) -> None:
    feed.stuck = True
    page.wait_for_selector("#age:has-text('No word from the flight')")
    feed.stuck = False
    page.wait_for_selector("#age", state="hidden")


def test_a_picture_that_stands_still_is_shown_as_old(page: Page, feed: Feed) -> None:
    feed.frames = False
    until(lambda: re.match(r"\['stage', 'The picture is", str(old_parts(page))))
    feed.frames = True
    page.wait_for_selector("#age", state="hidden")


def test_who_withdraws_consent_does_not_give_it_because_it_let_go_just_then(
    page: Page, feed: Feed, served: Any
) -> None:
    page.wait_for_selector("#consent:has-text('Withdraw')")
    before = len(asked(served, "consent"))
    feed.moment = RELEASED
    page.evaluate(
        """() => new Promise(done => { const look = setInterval(() => {
            if (!$("consent").textContent.startsWith("Allow")) return;
            clearInterval(look); $("consent").click(); done(); }, 1); })"""
    )
    page.wait_for_selector("#consent:enabled:has-text('Allow')")
    assert len(asked(served, "consent")) == before
    with one_more(served, "consent"):
        page.click("#consent")
    assert asked(served, "consent")[-1]["given"]


def press(page: Page, key: str, times: int) -> None:
    for _ in range(times):
        page.keyboard.press(key)


def test_a_target_is_chosen_by_keyboard_where_it_is_aimed_at(page: Page, served: Any) -> None:
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "glass"
    press(page, "ArrowRight", 10)
    press(page, "ArrowUp", 5)
    with one_more(served, "select_point"):
        page.keyboard.press("Enter")
    point = asked(served, "select_point")[-1]
    assert (point["x"], point["y"]) == (pytest.approx(0.6), pytest.approx(0.45))
    press(page, "Shift+ArrowLeft", 20)
    press(page, "Shift+ArrowDown", 30)
    press(page, "ArrowUp", 1)
    with one_more(served, "select_box"):
        page.keyboard.press("Enter")
    box = asked(served, "select_box")[-1]
    assert [box[side] for side in ("left", "top", "right", "bottom")] == [
        pytest.approx(share) for share in (0.4, 0.44, 0.6, 0.74)
    ]
    with one_more(served, "stop"):
        page.keyboard.press("Space")


def test_what_is_aimed_at_stays_in_the_picture(page: Page, served: Any) -> None:
    page.focus("#glass")
    press(page, "ArrowLeft", 60)
    with one_more(served, "select_point"):
        page.keyboard.press("Enter")
    assert 0 <= asked(served, "select_point")[-1]["x"] < 0.02


def test_enter_chooses_nothing_where_nothing_is_shown_as_aimed_at(page: Page, served: Any) -> None:
    with one_more(served, "select_point"):
        page.click("#glass")
        with one_more(served, "stop_tracking"):  # what is asked arrives in its order
            press(page, "Enter", 1)
            page.click("#drop")


def test_two_hundred_flights_are_listed_and_the_one_in_focus_stays_so(page: Page) -> None:
    flights = [
        {"name": f"f-{number}", "changed_s": 0, "megabytes": 1, "has_video": True}
        | {"has_report": True}
        for number in range(200)
    ]
    page.route("**/api/flights", lambda route: route.fulfill(json=flights))
    page.evaluate("listFlights()")
    assert page.locator("#flights li").count() == 200
    assert page.evaluate("document.documentElement.scrollHeight") < 3000
    page.get_by_role("link", name="report of f-150", exact=True).focus()
    scrolled = page.evaluate("$('flights').scrollTop")
    flights.insert(0, {**flights[0], "name": "newest"})
    page.evaluate("listFlights()")
    assert page.locator("#flights li").count() == 201
    assert page.evaluate("document.activeElement.ariaLabel") == "report of f-150"
    assert page.evaluate("$('flights').scrollTop") == scrolled > 0


def test_a_new_state_is_read_aloud_and_the_same_one_is_not_again(page: Page, feed: Feed) -> None:
    page.evaluate(
        """() => { window.said = []; new MutationObserver(() => said.push($("state").textContent))
            .observe($("state"), { childList: true, characterData: true, subtree: true }); }"""
    )
    heard = page.evaluate("state.time_s")
    until(lambda: page.evaluate("state.time_s") > heard + 0.5)
    feed.moment = RELEASED
    page.wait_for_selector("#state[data-state=released]")
    assert page.evaluate("said") == ["RELEASED"]
    assert page.get_attribute("#state", "role") == "status"


def test_nothing_but_letting_go_is_put_into_a_line_that_does_not_move(
    page: Page, served: Any
) -> None:
    before = len(asked(served, "stop_tracking"))
    page.evaluate("() => { heard = -1e9; $('drop').click(); }")
    page.wait_for_selector("#hint.bad:has-text('silent')")
    assert len(asked(served, "stop_tracking")) == before
    with one_more(served, "stop"):
        page.evaluate("() => { heard = -1e9; stop(); }")


def test_a_withdrawal_that_is_not_answered_takes_another_way(page: Page, served: Any) -> None:
    with one_more(served, "consent"):
        page.evaluate("() => { socket.send = () => {}; }")
        page.click("#consent:has-text('Withdraw')")
    assert not asked(served, "consent")[-1]["given"]


def test_that_stop_was_not_answered_is_seen_wherever_one_has_scrolled(
    browser: Browser, open_page: Any, served: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(served.station.operator, "answers", False)
    phone = open_page(browser, viewport={"width": 360, "height": 640}, is_mobile=True)
    with closing(phone.context):
        phone.goto(served.url)
        phone.wait_for_selector("#gains .gain")
        phone.evaluate("$('recordings').scrollIntoView()")
        phone.click("#stop")
        phone.wait_for_selector("#hint.bad:has-text('transmitter')")
        hint, actions = (phone.locator(one).bounding_box() for one in ("#hint", "#actions"))
        assert 0 <= hint["y"] <= hint["y"] + hint["height"] <= actions["y"]
        until(lambda: phone.evaluate("pending.size") == 0)  # the server gives up later
        assert "transmitter" in str(phone.text_content("#hint"))


@pytest.mark.parametrize("size", [(1280, 900), (360, 640)])
def test_every_setting_is_named_in_full_and_units_keep_their_letters(
    browser: Browser, open_page: Any, served: Any, size: tuple[int, int]
) -> None:
    page = open_page(browser, viewport=dict(zip(("width", "height"), size, strict=True)))
    with closing(page.context):
        page.goto(served.url)
        page.wait_for_selector("#gains .gain")
        page.evaluate("document.querySelector('details').open = true")
        labels = "[...document.querySelectorAll('.gain label')]"
        cut = f"{labels}.filter(one => one.scrollWidth > one.clientWidth).map(one => one.innerText)"
        assert page.evaluate(f"{labels}.length") > 50
        assert page.evaluate(cut) == []
        assert "Forward (m/s)" in page.locator(".plot h2").all_inner_texts()


def test_another_flights_settings_have_its_own_ranges(page: Page) -> None:
    """A page that stays open is connected to whatever flies next at its address."""
    slider = page.locator("[data-key='envelope.max_speed_m_s'] input[type=range]")
    assert slider.get_attribute("max") == "10"
    page.evaluate(
        """() => { const next = structuredClone(page);
        next.settings.find(one => one.key === "envelope.max_speed_m_s").high = 4;
        take({ kind: "hello", page: next }); }"""
    )
    assert slider.get_attribute("max") == "4"
    assert page.locator("[data-key='envelope.max_speed_m_s']").count() == 1


def test_what_has_no_value_has_no_slider_that_shows_one(page: Page, served: Any) -> None:
    row = page.locator("[data-key='servo.target_size_m']")
    assert row.locator("input[type=range]").count() == 0
    page.locator("summary").click()
    with one_more(served, "change"):
        row.locator("input").fill("4.5")
        row.locator("input").press("Enter")
    assert asked(served, "change")[-1]["value"] == 4.5


def test_a_number_that_is_deleted_is_shown_again(page: Page, served: Any) -> None:
    served.station.tell_page({"values": {"servo.azimuth.kp": 1.5}})
    field = page.locator("[data-key='servo.azimuth.kp'] input[type=number]")
    until(lambda: field.input_value() == "1.5")
    field.fill("")
    field.press("Enter")
    assert field.input_value() == "1.5"


def test_who_gives_consent_is_said_where_the_page_cannot(page: Page, feed: Feed) -> None:
    feed.moment = RELEASED
    page.evaluate("() => take({ kind: 'page', page: { ...page, consent: 'rc' } })")
    page.wait_for_selector("#consent:disabled:text-is('Consent is by rc')")


def test_stop_can_be_pressed_in_every_way(page: Page, served: Any) -> None:
    ways: list[Callable[[], None]] = [
        lambda: page.click("#stop"),
        lambda: page.press("#stop", "Enter"),
        lambda: page.press("body", "Space"),
        lambda: page.press("#gains input[type=number] >> nth=0", "Space"),
        lambda: page.evaluate("$('stop').click()"),
    ]
    for way in ways:
        with one_more(served, "stop"):
            way()


def test_another_button_of_the_mouse_chooses_nothing(page: Page, served: Any) -> None:
    before = len(asked(served, "select_point"))
    page.click("#glass", button="right")
    with one_more(served, "select_point"):
        page.click("#glass")
    assert len(asked(served, "select_point")) == before + 1


def test_who_cannot_take_control_is_told(page: Page, browser: Browser, open_page: Any) -> None:
    watcher = open_page(browser)
    watcher.goto(page.url)
    watcher.click("#take")
    watcher.wait_for_selector("#hint.bad:has-text('in control')")
    watcher.context.close()


def drag_two_fingers(page: Page, across: int, down: int) -> None:
    """Move two fingers apart, one to the left and one to the right of a point."""
    fingers = page.context.new_cdp_session(page)

    def touch(kind: str, *apart: int) -> None:
        points = [{"x": across + dx, "y": down + dx, "id": int(dx > 0)} for dx in apart]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", -30)
    touch("touchStart", -30, 30)
    touch("touchMove", -90, 90)
    touch("touchEnd", -90)
    touch("touchEnd")


def test_two_fingers_choose_nothing(page: Page, served: Any) -> None:
    before = len(asked(served, "select_box"))
    box = page.locator("#glass").bounding_box()
    drag_two_fingers(page, round(box["x"] + box["width"] / 2), round(box["y"] + box["height"] / 2))
    with one_more(served, "stop_tracking"):  # requests come in their order
        page.click("#drop")
    assert len(asked(served, "select_box")) == before


def test_nothing_is_chosen_on_a_picture_that_is_old(page: Page, feed: Feed, served: Any) -> None:
    feed.frames = False
    page.wait_for_selector("#age:has-text('The picture is')")
    before = len(asked(served, "select_point"))
    page.click("#glass")
    page.wait_for_selector("#hint.bad:has-text('picture is old')")
    assert len(asked(served, "select_point")) == before
    feed.frames = True
    page.wait_for_selector("#age", state="hidden")
    with one_more(served, "select_point"):
        page.click("#glass")


def test_numbers_do_not_outlive_the_line_and_are_asked_for_again(page: Page) -> None:
    page.evaluate(
        """() => { window.said = []; const send = WebSocket.prototype.send;
        WebSocket.prototype.send = function (text) { said.push(text);
          if (!text.includes("objects")) send.call(this, text); };
        page.objects = true; take({ kind: "hello", page }); $("objects").click();
        take({ kind: "objects", objects: [{ number: 1, name: "car", box: [0, 0, 1, 1] }] }); }"""
    )
    assert page.evaluate("objects.length") == 1
    page.evaluate("() => { said = []; take({ kind: 'hello', page }); }")
    assert page.evaluate("objects") == []
    assert '{"kind":"objects","on":true}' in page.evaluate("said")
    page.evaluate(
        "() => { said = []; take({ kind: 'hello', page: { ...page, objects: false } }); }"
    )
    assert not page.evaluate("wantObjects")
    assert not [text for text in page.evaluate("said") if "objects" in text]


def test_any_token_opens_the_page_by_the_address_that_is_told(
    browser: Browser, open_page: Any, serve: Any, tmp_path: Path
) -> None:
    (tmp_path / "token").write_text("50%41 #secure%zz?key", "utf-8")
    served = serve(f"cockpit.token_file={tmp_path / 'token'}")
    told = next(line for line in served.said if line.startswith("Cockpit: "))
    page = open_page(browser)
    with closing(page.context):
        page.goto(f"{served.url}/#50%")
        page.wait_for_selector("#login")
        page.goto("about:blank")
        page.goto(told.removeprefix("Cockpit: "))
        page.wait_for_selector("#connection.good")


def test_who_mistypes_the_token_too_often_is_told_to_wait(
    browser: Browser, open_page: Any, serve: Any, tmp_path: Path
) -> None:
    """The right one, too, was then called wrong."""
    (tmp_path / "token").write_text("a token of some length", "utf-8")
    page = open_page(browser)
    with closing(page.context):
        page.goto(serve(f"cockpit.token_file={tmp_path / 'token'}").url)
        page.fill("#token", "a token of some lenght")

        def told_to_wait() -> bool:
            with page.expect_response("**/api/session"):
                page.click("#login button")
            return "wait" in page.inner_text("#refused")

        until(told_to_wait)  # how many it takes depends on how quick they come


class Relay:
    """A network between a page and its server, which can be cut.

    Args:
        port: of the server.
    """

    def __init__(self, port: int) -> None:
        self._server = "127.0.0.1", port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._lines: list[socket.socket] = []
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Break all lines that there are."""
        for line in self._lines:
            with suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Listen no more."""
        self._listener.close()
        self.cut()
        for line in self._lines:
            line.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                ends = self._listener.accept()[0], socket.create_connection(self._server)
                self._lines += ends
                for one, other in (ends, ends[::-1]):
                    threading.Thread(target=self._pass_on, args=(one, other), daemon=True).start()

    def _pass_on(self, one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(65536):
                other.sendall(data)
        with suppress(OSError):
            other.shutdown(socket.SHUT_RDWR)


@pytest.mark.usefixtures("feed")
def test_pictures_come_again_after_the_network_broke(
    browser: Browser, open_page: Any, served: Any
) -> None:
    page = open_page(browser)
    page.add_init_script("delete window.RTCPeerConnection")
    with closing(page.context), closing(Relay(served.port)) as relay:
        page.goto(relay.url)
        until(lambda: page.evaluate("$('mjpeg').naturalWidth") == 64)
        relay.cut()
        until(lambda: page.evaluate("$('mjpeg').naturalWidth") == 0)
        until(lambda: page.evaluate("$('mjpeg').naturalWidth") == 64)
