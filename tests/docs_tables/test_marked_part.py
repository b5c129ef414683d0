"""What a program writes into a page leaves everything else as it was."""

import pytest
from marked_part import with_part

PAGE = "before\n<a>\nold\n</a>\nafter\n"


def test_the_text_between_the_marks_is_another_one_and_nothing_else() -> None:
    page = with_part(PAGE, "<a>", "</a>", "new")
    assert page == PAGE.replace("old", "new")
    assert with_part(page, "<a>", "</a>", "new") == page


@pytest.mark.parametrize("page", ["", "<a>\nold\n", "old\n</a>\n", "</a>\nold\n<a>\n"])
def test_a_page_without_its_marks_is_refused(page: str) -> None:
    with pytest.raises(ValueError, match="<a>"):
        with_part(page, "<a>", "</a>", "new")
