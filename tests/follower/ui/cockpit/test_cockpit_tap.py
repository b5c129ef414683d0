"""Numbers in a real browser: what our own detector sees in a simulation is tapped and followed."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

TRIES, FOLLOWED_WITHIN_S = 5, 8.0
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("chromium")]
BLUE_PIXELS = """box => {
  const glass = document.querySelector('#glass'), ratio = glass.width / glass.clientWidth;
  const v = view(), left = ratio * (v.x + box[0] * v.w), top = ratio * (v.y + box[1] * v.h);
  const side = Math.round(ratio * (box[2] - box[0]) * v.w);
  const data = glass.getContext('2d').getImageData(left, top - 3, side, 6).data;
  let count = 0;
  for (let at = 0; at < data.length; at += 4)
    count += data[at] < 150 && data[at + 1] > 120 && data[at + 2] > 200;
  return count;
}"""
"""How many pixels along a box's upper side have the colour of numbered boxes."""


@pytest.fixture(scope="module")
def phone(browser: Browser, open_page: Any, seeing: Any) -> Page:
    size = {"width": 412, "height": 839}
    page: Page = open_page(
        browser, viewport=size, device_scale_factor=2.0, is_mobile=True, has_touch=True
    )
    page.goto(seeing.url)
    page.wait_for_selector("#connection:has-text('connected')")
    page.wait_for_selector("#reason:has-text('airborne')")
    return page


def numbered_car(page: Page, seeing: Any) -> dict[str, Any] | None:
    """Return the numbered object that lies on the car, as the page has it now."""
    car, frame = seeing.eye.car(), seeing.eye.frame
    if car is None:
        return None
    for one in page.evaluate("objects"):
        left, top, right, bottom = one["box"]
        across = left * frame.width <= car.cx <= right * frame.width
        if across and top * frame.height <= car.cy <= bottom * frame.height:
            return dict(one)
    return None


def want_numbers(page: Page, wanted: bool) -> None:
    """Press the button unless it stands as wanted."""
    if page.evaluate("wantObjects") != wanted:
        page.tap("#objects")


def tap(page: Page, box: list[float]) -> None:
    glass = page.locator("#glass").bounding_box()
    x = glass["x"] + glass["width"] * (box[0] + box[2]) / 2
    page.touchscreen.tap(x, glass["y"] + glass["height"] * (box[1] + box[3]) / 2)


def tap_car(page: Page, seeing: Any) -> None:
    """Tap the car's number, while the world stands still if it has one then."""
    for _ in range(TRIES):
        seeing.wait_for(page, lambda: numbered_car(page, seeing), "a number")
        with seeing.standing_still():
            if car := numbered_car(page, seeing):
                tap(page, car["box"])
                return
    pytest.fail("the car has a number for moments only")


def test_what_our_detector_sees_is_numbered_on_the_picture(
    phone: Page, seeing: Any, picture: Any
) -> None:
    want_numbers(phone, False)
    assert phone.evaluate("objects") == []
    want_numbers(phone, True)
    car = seeing.wait_for(phone, lambda: numbered_car(phone, seeing), "the car numbered")
    assert car["number"] >= 1
    assert re.fullmatch(r"\w+:\d+", car["name"])
    seeing.wait_for(
        phone,
        lambda: (one := numbered_car(phone, seeing)) and phone.evaluate(BLUE_PIXELS, one["box"]),
        "its box drawn",
    )
    picture(phone, "cockpit-numbers")


def test_what_is_tapped_is_followed(phone: Page, seeing: Any, picture: Any) -> None:
    want_numbers(phone, True)
    for _ in range(TRIES):
        tap_car(phone, seeing)
        if seeing.comes_within(phone, seeing.is_following_target, FOLLOWED_WITHIN_S):
            break
    assert seeing.operator.objects >= 1, "a tap on a number asks for that object"
    phone.wait_for_selector("#state[data-state=following]")
    seeing.wait_for(phone, seeing.is_on_target, "the car followed")
    controls = seeing.flight.log.controls
    seeing.wait_for(
        phone, lambda: max(map(abs, controls[-1].allowed.values)) > 0.3, "the drone moving"
    )
    picture(phone, "cockpit-tapped")


def test_a_line_that_died_without_a_word_is_told_and_stop_takes_another_way(
    phone: Page, seeing: Any
) -> None:
    phone.evaluate("() => { socket.onmessage = () => {}; socket.send = () => {}; }")
    phone.wait_for_selector("#connection.bad:has-text('silent')")
    assert phone.evaluate("document.body.classList.contains('old')"), "what is shown is marked"
    phone.tap("#stop")
    seeing.wait_for(phone, lambda: seeing.operator.stops_s, "the stop received")
    phone.wait_for_selector("#connection.good:has-text('connected')")
    phone.wait_for_selector("#state[data-state=released]")
    seeing.wait_for(phone, lambda: not phone.evaluate("document.body.className"), "nothing marked")


def test_when_nobody_wants_numbers_there_are_none(phone: Page, seeing: Any) -> None:
    want_numbers(phone, True)
    seeing.wait_for(phone, lambda: phone.evaluate("objects"), "numbers")
    want_numbers(phone, False)
    phone.evaluate("() => take({ kind: 'objects', objects: [{ box: [0, 0, 1, 1] }] })")
    assert phone.evaluate("objects") == [], "what was on its way is not shown"
    phone.wait_for_timeout(1000)
    assert phone.evaluate("objects") == []
