"""The page about the log says what the table of messages says."""

from pathlib import Path

import pytest

from follower.recorder.docs import messages_markdown, renewed
from follower.recorder.fields import fields_of, unit_of
from follower.recorder.messages import BY_RECORD, BY_TOPIC, MESSAGES

PAGE = Path(__file__).parents[3] / "docs" / "flight-log.md"


def test_the_page_is_up_to_date() -> None:
    page = PAGE.read_text("utf-8")
    assert page == renewed(page), "python -m follower.recorder.docs docs/flight-log.md"


def test_every_message_and_field_is_on_the_page() -> None:
    text = messages_markdown()
    for message in MESSAGES:
        section = text.partition(f"### {message.topic}\n")[2].partition("\n###")[0]
        for field in fields_of(message.record):
            assert f"`{field.name}" in section


def test_topics_and_records_are_each_used_once() -> None:
    assert len(BY_TOPIC) == len(BY_RECORD) == len(MESSAGES)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("yaw_rate_rad_s", "rad/s"),
        ("forward_m_s", "m/s"),
        ("range_m", "m"),
        ("time_s", "s"),
        ("elevation_rad", "rad"),
        ("log_scale_rate_s", "1/s"),
        ("cx", "px"),
        ("sequence", ""),
    ],
)
def test_a_fields_name_says_its_unit(name: str, unit: str) -> None:
    assert unit_of(name) == unit


def test_a_page_without_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="lacks"):
        renewed("# nothing here")
