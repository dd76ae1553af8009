"""The ten questions of CONTRIBUTING.md: the table says what a tracer finds."""

import re

import pytest

from workshop.results.questions import PAGE, QUESTIONS, row


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: question.text)
def test_the_page_says_what_is_read(question):
    (stored,) = re.findall(
        rf"^\| {re.escape(question.text)} \|.*\n", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert stored == row(question), "run: python -m workshop questions"
