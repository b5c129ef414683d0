"""The page on faults, and what a program writes into a page."""

from dataclasses import replace
from pathlib import Path

import pytest
from faults_page import PAGE, passed_of, sections
from marked_part import with_part

from follower.simulation.fault_tests.results import FaultResult, Results, Tally
from follower.simulation.faults.fault import catalogue, fault_named
from follower.simulation.faults.judge import FaultMetrics, FaultVerdict


def test_the_page_has_each_fault_with_the_catalogues_sentence() -> None:
    lines = [one for one in PAGE.read_text("utf-8").splitlines() if one.startswith("- `")]
    missing = [
        fault.name
        for fault in catalogue()
        if not any(f"`{fault.name}`" in line and f": {fault.must}" in line for line in lines)
    ]
    assert missing == []


def test_the_page_tells_what_was_not_flown_and_what_does_not_apply(tmp_path: Path) -> None:
    results = Results(tmp_path / "results.json")
    verdict = FaultVerdict("vision-dies", "hold", (), FaultMetrics(hold_s=0.5), "released")
    results.add(FaultResult("px4", "pymavlink", False, verdict))
    text = "\n".join(sections(results, Tally.load(tmp_path / "random.json", 0)))
    line = next(one for one in text.splitlines() if one.startswith("- `vision-dies`"))
    assert line.endswith(" (pymavlink 1/1; ardupilot not flown; mavsdk not flown)")
    assert "1/1 cases passed; worst: hold 0.5 s.\n\n- `vision-dies`" in text
    alone = replace(fault_named("vision-dies"), links=("pymavlink",))
    assert passed_of(alone, "mavsdk", list(results)) == "does not apply"


SHORT_PAGE = "before\n<a>\nold\n</a>\nafter\n"


def test_the_text_between_the_marks_is_another_one_and_nothing_else() -> None:
    page = with_part(SHORT_PAGE, "<a>", "</a>", "new")
    assert page == SHORT_PAGE.replace("old", "new")
    assert with_part(page, "<a>", "</a>", "new") == page


@pytest.mark.parametrize("page", ["", "<a>\nold\n", "old\n</a>\n", "</a>\nold\n<a>\n"])
def test_a_page_without_its_marks_is_refused(page: str) -> None:
    with pytest.raises(ValueError, match="<a>"):
        with_part(page, "<a>", "</a>", "new")
