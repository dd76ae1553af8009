"""Worked answers: every one names an experiment, and prints what the page says."""

import re

import nbformat
import pytest
from notebook_comparison import Printed

from course import nbtools
from workshop.publish import answers

ANSWERED = [found[2] for found in answers.ANSWER.finditer(answers.PAGE.read_text("utf-8"))]


def test_every_experiment_has_its_answer_in_their_order():
    asked = []
    for path in nbtools.notebooks():
        cells = nbformat.read(path, as_version=4).cells
        prose = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
        asked += re.findall(r"^\*\*(\d\d\.\d) \(experiment\)", prose, re.MULTILINE)
    assert asked == ANSWERED
    for name in ANSWERED:
        _, printed = answers.codes(name[:2])[name]
        assert printed.strip(), name


@pytest.mark.slow  # each runs its notebook
@pytest.mark.parametrize("number", ["03", "06"])
def test_answers_print_what_the_page_says(number):
    for name, text in answers.run(number).items():
        assert Printed(text, rtol=0.02, atol=0.2) == answers.codes(number)[name][1], name
