"""The page about the log says what the table of messages says."""

import re

import pytest
from flight_log_messages import MESSAGE_LISTS, messages_markdown, nested_records

from follower.recording.codec import fields_of
from follower.recording.messages import BY_TOPIC, MESSAGES
from follower.settings.field_docs import unit_of


def test_the_page_is_up_to_date() -> None:
    page = MESSAGE_LISTS.now()
    assert page == MESSAGE_LISTS.renewed(), "python tests/docs_tables/flight_log_messages.py"


def test_every_message_and_field_is_on_the_page() -> None:
    text = messages_markdown()
    for message in MESSAGES:
        section = text.partition(f"### {message.topic}\n")[2].partition("\n###")[0]
        for field in fields_of(message.record):
            assert f"`{field.name}`" in section


def test_records_in_messages_have_a_list_each_and_every_link_leads_to_one() -> None:
    text = messages_markdown()
    assert len(nested_records()) > 5
    for record in nested_records():
        section = text.partition(f"#### {record.__name__}\n")[2].partition("\n###")[0]
        assert all(f"`{field.name}`" in section for field in fields_of(record))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    anchors = {heading.replace("/", "").lower() for heading in headings}
    assert len(anchors) == len(headings)
    assert set(re.findall(r"\(#(\w+)\)", text)) <= anchors


def test_topics_and_records_are_each_used_once() -> None:
    assert len(BY_TOPIC) == len({message.record for message in MESSAGES}) == len(MESSAGES)


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
