"""Numbers in a real browser: what our own detector sees in a simulation is tapped and followed."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, sync_playwright

PATIENCE_MS = 120_000
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
TRIES = 5
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium to test the page with"),
]
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
def phone(seeing: Any) -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        context = browser.new_context(
            viewport={"width": 412, "height": 839},
            device_scale_factor=2.0,
            is_mobile=True,
            has_touch=True,
        )
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.goto(seeing.url)
        page.wait_for_selector("#connection:has-text('connected')")
        page.wait_for_selector("#reason:has-text('airborne')")
        yield page
        browser.close()


def wait_for(page: Page, condition: Callable[[], Any], what: str) -> Any:
    for _ in range(PATIENCE_MS // 50):
        if found := condition():
            return found
        page.wait_for_timeout(50)
    pytest.fail(f"waited in vain: {what}")


def picture(page: Page, name: str) -> None:
    """Keep a screenshot where somebody asks for it, to look at and for the docs."""
    folder = os.environ.get("FOLLOWER_SCREENSHOTS")
    if folder:
        page.screenshot(path=Path(folder) / f"{name}.png")


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


def tap(page: Page, box: list[float]) -> None:
    glass = page.locator("#glass").bounding_box()
    assert glass is not None
    x = glass["x"] + glass["width"] * (box[0] + box[2]) / 2
    page.touchscreen.tap(x, glass["y"] + glass["height"] * (box[1] + box[3]) / 2)


def follows_car(seeing: Any) -> bool:
    """Whether what is followed is the car, as a person would see it."""
    car, tracks = seeing.eye.car(), seeing.flight.log.tracks
    track = tracks[-1].track if tracks else None
    return car is not None and track is not None and car.iou(track.box) > 0.3


def test_what_our_detector_sees_is_numbered_on_the_picture(phone: Page, seeing: Any) -> None:
    assert phone.evaluate("objects") == []
    phone.tap("#objects")
    car = wait_for(phone, lambda: numbered_car(phone, seeing), "the car numbered")
    assert car["number"] >= 1
    assert re.fullmatch(r"\w+:\d+", car["name"])
    wait_for(
        phone,
        lambda: (one := numbered_car(phone, seeing)) and phone.evaluate(BLUE_PIXELS, one["box"]),
        "its box drawn",
    )
    picture(phone, "cockpit-numbers")


def test_what_is_tapped_is_followed(phone: Page, seeing: Any) -> None:
    assert phone.get_attribute("#state", "data-state") == "idle"
    for _ in range(TRIES):
        tap(phone, wait_for(phone, lambda: numbered_car(phone, seeing), "a number")["box"])
        phone.wait_for_timeout(2000)
        if follows_car(seeing):
            break
    assert seeing.operator.objects >= 1, "a tap on a number asks for that object"
    phone.wait_for_selector("#state[data-state=following]")
    wait_for(phone, lambda: follows_car(seeing), "the car followed")
    controls = seeing.flight.log.controls
    wait_for(phone, lambda: max(map(abs, controls[-1].allowed.values)) > 0.3, "the drone moving")
    picture(phone, "cockpit-tapped")


def test_a_line_that_died_without_a_word_is_told_and_stop_takes_another_way(
    phone: Page, seeing: Any
) -> None:
    phone.evaluate("() => { socket.onmessage = () => {}; socket.send = () => {}; }")
    phone.wait_for_selector("#connection.bad:has-text('silent')")
    assert phone.evaluate("document.body.classList.contains('old')"), "what is shown is marked"
    phone.tap("#stop")
    wait_for(phone, lambda: seeing.operator.stops_s, "the stop received")
    phone.wait_for_selector("#connection.good:has-text('connected')")
    phone.wait_for_selector("#state[data-state=released]")
    wait_for(phone, lambda: not phone.evaluate("document.body.className"), "nothing marked")


def test_when_nobody_wants_numbers_there_are_none(phone: Page) -> None:
    phone.tap("#objects")
    phone.wait_for_timeout(1000)
    assert phone.evaluate("objects") == []
