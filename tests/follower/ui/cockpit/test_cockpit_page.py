"""The page in a real browser, on a running simulation: drag, follow, tune, stop."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from cockpit_client import connect, message, say
from playwright.sync_api import Browser, Page
from waiting import until

from follower.apps.replay.comparison import compare
from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.log import ControlRecord
from follower.flight.supervision.supervisor import SupervisorState
from follower.recording import open_flight
from follower.settings.live import live_keys
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.vehicle.setpoint import HOLD
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame

TRIES, FOLLOWED_WITHIN_S = 8, 8.0
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("chromium")]


@pytest.fixture(scope="module")
def page(browser: Browser, open_page: Any, simulation: Any) -> Iterator[Page]:
    page = open_page(browser, viewport={"width": 1280, "height": 1000})
    trouble: list[str] = []
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.goto(simulation.url)
    page.wait_for_selector("#connection:has-text('connected')")
    yield page
    assert not trouble


def drag_over_car(page: Page, simulation: Any) -> None:
    """Draw a box about the car, while the world stands still if it is still in view then."""
    for _ in range(TRIES):
        simulation.wait_for(page, simulation.car_well_in_view, "the car in view")
        with simulation.standing_still():
            if car := simulation.car_well_in_view():
                drag_over(page, car, simulation.eye.frame)
                return
    pytest.fail("the car is in view for moments only")


def drag_over(page: Page, box: Box, frame: Frame) -> None:
    glass = page.locator("#glass").bounding_box()
    assert glass["width"] / glass["height"] == pytest.approx(frame.width / frame.height, rel=0.02)
    across, down = glass["width"] / frame.width, glass["height"] / frame.height
    page.mouse.move(glass["x"] + across * (box.left - 1), glass["y"] + down * (box.top - 1))
    page.mouse.down()
    page.mouse.move(glass["x"] + across * box.cx, glass["y"] + down * box.cy)
    page.mouse.move(glass["x"] + across * (box.right + 1), glass["y"] + down * (box.bottom + 1))
    page.mouse.up()


def follow(page: Page, simulation: Any) -> None:
    """Choose the car, again if it had driven out of view before the vehicle was steered."""
    for _ in range(TRIES):
        drag_over_car(page, simulation)
        if simulation.comes_within(page, simulation.is_following_target, FOLLOWED_WITHIN_S):
            page.wait_for_selector("#state[data-state=following]")
            return
    last = controls(simulation)[-1]
    pytest.fail(f"the car was not followed: {last.state}, {last.reason}, {last.situation}")


def controls(simulation: Any) -> list[ControlRecord]:
    return list(simulation.flight.log.controls)


def test_the_page_shows_live_video(page: Page) -> None:
    page.wait_for_selector("#stage:not([data-video=none])")
    way = page.get_attribute("#stage", "data-video")
    print(f"video by {way}")
    shown = "#video" if way == "webrtc" else "#mjpeg"
    width = "videoWidth" if way == "webrtc" else "naturalWidth"
    assert page.evaluate(f"document.querySelector('{shown}').{width}") == 320


def test_a_target_that_is_dragged_over_is_followed(
    page: Page, simulation: Any, picture: Any
) -> None:
    page.wait_for_selector("#reason:has-text('airborne')")
    assert page.get_attribute("#state", "data-state") == "idle"
    follow(page, simulation)
    simulation.wait_for(page, simulation.is_on_target, "the car followed")
    simulation.wait_for(
        page,
        lambda: max(map(abs, controls(simulation)[-1].allowed.values)) > 0.3,
        "the drone moving",
    )
    page.wait_for_timeout(3000)
    picture(page, "cockpit")


def test_a_browser_without_webrtc_is_shown_pictures(
    browser: Browser, open_page: Any, simulation: Any
) -> None:
    page = open_page(browser)
    page.add_init_script("delete window.RTCPeerConnection")
    page.goto(simulation.url)
    page.wait_for_selector("#stage[data-video=mjpeg]")
    assert page.evaluate("document.querySelector('#mjpeg').naturalWidth") == 320
    page.close()


def test_a_gain_is_changed_and_control_goes_by_it(page: Page, simulation: Any) -> None:
    field = page.locator("[data-key='servo.azimuth.kp'] input[type=number]")
    field.fill("1.25")
    field.press("Enter")
    simulation.wait_for(
        page, lambda: simulation.flight.stage.settings.servo.azimuth.kp == 1.25, "the gain"
    )
    page.wait_for_selector("[data-key='servo.azimuth.kp'].changed")
    keys = {change.key for record in controls(simulation) for change in record.changes}
    assert "servo.azimuth.kp" in keys


def test_a_limit_cannot_be_loosened_and_the_page_says_so(page: Page, simulation: Any) -> None:
    before = simulation.began.envelope.max_speed_m_s
    field = page.locator("[data-key='envelope.max_speed_m_s'] input[type=number]")
    field.fill(str(before + 5))
    field.press("Enter")
    page.wait_for_selector("#hint.bad:has-text('tightened')")
    assert simulation.flight.requests.settings.envelope.max_speed_m_s == before


def test_stop_stops_the_vehicle_within_300_ms(page: Page, simulation: Any, picture: Any) -> None:
    page.wait_for_selector("#state[data-state=following]")
    page.click("#stop")
    page.wait_for_selector("#state[data-state=released]")
    page.wait_for_selector("#reason:has-text('stop requested')")
    stopped_s = simulation.operator.stops_s[0]
    sent = [record for record in controls(simulation) if record.time_s >= stopped_s]
    zero_s = next(r.time_s for r in sent if r.sent and r.allowed == HOLD) - stopped_s
    assert zero_s <= 0.3
    print(f"zero setpoint {1000 * zero_s:.0f} ms after STOP was received")
    simulation.wait_for(page, lambda: speed(simulation) < 0.2, "the drone standing")
    assert all(record.allowed == HOLD for record in sent if record.time_s > stopped_s + 0.3)
    picture(page, "cockpit-stopped")


def speed(simulation: Any) -> float:
    return float(sum(v * v for v in simulation.flight.vehicle.state.velocity_m_s) ** 0.5)


def test_consent_on_the_page_ends_the_release(page: Page, simulation: Any) -> None:
    page.click("#consent:has-text('Allow following')")
    simulation.wait_for(
        page,
        lambda: simulation.flight.stage.supervisor.state is not SupervisorState.RELEASED,
        "not released any more",
    )
    page.wait_for_selector("#state:not([data-state=released])")


def test_after_consent_on_the_page_it_is_followed_again(page: Page, simulation: Any) -> None:
    if not simulation.comes_within(page, simulation.is_following_target, FOLLOWED_WITHIN_S):
        follow(page, simulation)
    page.wait_for_selector("#state[data-state=following]")


@pytest.mark.usefixtures("page")
@pytest.mark.parametrize(
    ("size", "name"),
    [
        ({"width": 412, "height": 839}, "cockpit-phone"),
        ({"width": 844, "height": 390}, "cockpit-phone-held-sideways"),
        ({"width": 932, "height": 430}, "cockpit-large-phone-held-sideways"),
    ],
)
def test_a_phone_shows_what_matters_at_once(
    browser: Browser, open_page: Any, simulation: Any, picture: Any, size: Any, name: str
) -> None:
    phone = open_page(
        browser, viewport=size, device_scale_factor=2.0, is_mobile=True, has_touch=True
    )
    phone.goto(simulation.url)
    phone.wait_for_selector("#control:has-text('watching')")
    phone.wait_for_selector("#stage:not([data-video=none])")
    assert phone.evaluate("document.documentElement.scrollWidth") <= size["width"]
    for part in ("#stop", "#consent", "#stage", "#state", "#reason"):
        box = phone.locator(part).bounding_box()
        assert box["y"] + box["height"] <= size["height"], part
    phone.wait_for_timeout(1500)
    picture(phone, name)
    phone.context.close()


def test_a_phone_watches_and_stops(
    browser: Browser, page: Page, open_page: Any, simulation: Any
) -> None:
    size = {"width": 412, "height": 839}
    phone = open_page(
        browser, viewport=size, device_scale_factor=2.0, is_mobile=True, has_touch=True
    )
    phone.goto(simulation.url)
    phone.wait_for_selector("#control:has-text('watching')")
    phone.tap("#glass")
    phone.wait_for_selector("#hint.bad:has-text('You watch')")
    stops = len(simulation.operator.stops_s)
    phone.tap("#stop")
    phone.wait_for_selector("#state[data-state=released]")
    page.wait_for_selector("#state[data-state=released]")
    assert len(simulation.operator.stops_s) == stops + 1
    phone.context.close()


def test_nothing_that_is_asked_goes_past_supervisor_and_envelope(
    page: Page, simulation: Any
) -> None:
    """Whatever a client asks for, as fast as it may; then the whole flight is looked through."""
    rng = np.random.default_rng(11)
    url = simulation.url.replace("http", "ws") + "/ws"
    page.close()
    with connect(url) as client:
        while not message(client, "control")["yours"]:  # until the page has left
            say(client, kind="take_control")
        for number in range(120):
            client.send(json.dumps({"id": number, **any_request(rng)}))
            time.sleep(0.03)
        say(client, kind="consent", given=False, id=1000)
        until(lambda: message(client, "answer")["id"] == 1000)
    records = controls(simulation)
    limits = simulation.began.envelope
    for before, record in itertools.pairwise(records):
        check_supervised(record)
        if record.sent:
            check_limited(before, record, limits)
    assert simulation.flight.requests.settings.envelope.max_speed_m_s <= limits.max_speed_m_s


def any_request(rng: np.random.Generator) -> dict[str, Any]:
    x, y = rng.uniform(0, 1, 2).tolist()
    key = str(rng.choice([one.key for one in live_keys()]))
    number = float(rng.choice([-1.0, 0.0, 0.5, 3.0, 50.0, 1e6]))
    return dict(
        [
            {"kind": "select_point", "x": x, "y": y},
            {"kind": "select_box", "left": x, "top": y, "right": y, "bottom": x},
            {"kind": "consent", "given": True},
            {"kind": "change", "key": key, "value": number},
            {"kind": "change", "key": "servo.mode", "value": "orbit"},
            {"kind": "change", "key": "envelope.max_speed_m_s", "value": 99.0},
            {"kind": "stop_tracking"},
            {"kind": "arm"},
        ][rng.choice(8, p=[0.1, 0.1, 0.2, 0.35, 0.05, 0.1, 0.05, 0.05])]
    )


def check_supervised(record: ControlRecord) -> None:
    """Nobody steers but in the pilot's mode, in the air, with consent."""
    if record.state.steers:
        assert record.situation.mode_allows
        assert record.situation.flying
        assert record.situation.consent_given
        assert not record.situation.stop_requested
    if not record.state.engaged and record.sent:
        assert record.asked == HOLD


def check_limited(before: ControlRecord, record: ControlRecord, limits: EnvelopeSettings) -> None:
    """Limits that the flight began with hold, but for the stop button's zero."""
    now, then, dt = record.allowed, before.allowed, record.time_s - before.time_s
    assert math.hypot(now.forward_m_s, now.right_m_s) <= limits.max_speed_m_s + 1e-6
    assert -limits.max_climb_m_s - 1e-6 <= now.down_m_s <= limits.max_descent_m_s + 1e-6
    assert abs(now.yaw_rate_rad_s) <= math.radians(limits.max_yaw_rate_deg_s) + 1e-6
    if before.sent and before.state.engaged and not record.situation.stop_at_once:
        step = math.hypot(now.forward_m_s - then.forward_m_s, now.right_m_s - then.right_m_s)
        assert step <= limits.max_acceleration_m_s2 * dt + 0.02


def test_what_people_did_on_the_page_is_replayed_bit_for_bit(simulation: Any) -> None:
    """Control alone, from the recorded tracks."""
    simulation.end()
    flight = open_flight(simulation.folder)
    assert len(flight.log.controls) > 500
    replay = Replay(flight, replay_settings(flight), tracks_recorded=True)
    assert compare(flight.log, replay.run()).identical
