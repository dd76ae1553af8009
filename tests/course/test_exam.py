"""The exam's figures can be drawn, and show what their answers say."""

import re

import matplotlib.pyplot as plt
import numpy as np
import pytest

from course import nbtools

PAGE = (nbtools.ROOT / "book" / "exam.md").read_text(encoding="utf-8")


def test_there_are_thirty_questions_with_answers():
    questions = re.findall(r"^(\d+)\. \*(.+?)\* (\S.+)$", PAGE, re.MULTILINE)
    assert [int(number) for number, *_ in questions] == list(range(1, 31))


@pytest.mark.slow
def test_the_figures_show_what_is_wrong(monkeypatch):
    monkeypatch.chdir(nbtools.NOTEBOOKS)
    namespace = {}
    exec(re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1], namespace)
    plt.close("all")
    truth = namespace["frame"].gt_index(namespace["grid"])
    A, B, C = (namespace["figures"][name] for name in "ABC")
    good = namespace["winners"](namespace["data"].rig, namespace["frame"].images)
    wrong = [np.mean(np.abs(index - truth) > 3) for index in (good, A, B, C)]
    assert wrong[0] < 0.2 and min(wrong[1:]) > 2 * wrong[0], wrong
    # A: right behind the rig, too far on one side of camera 2's axis, too near on the other.
    off = [np.median((A - truth)[:, k : k + 40]) for k in (80, 160, 240)]
    assert abs(off[0]) < 0.5 and off[1] < -2 and off[2] > 2
    # B: right where cameras 3 and 4 decide.
    apart = np.abs(B - truth) > 3
    assert apart[:, :40].mean() < 0.1 and apart[:, 120:280].mean() > 0.8
    assert np.mean(C == 63) > 0.1
