"""What is said about durations."""

import re
import sys

import pytest
import torch

import omnistereo_lib as osl
from omnistereo_lib.progress import counted
from omnistereo_tools.judge import pace
from omnistereo_tools.judge.pace import in_words, say_frame
from omnistereo_tools.progress import progress_bar


def test_durations_in_words():
    seconds = [0.2, 8.4, 43, 89, 170, 5000, 9000]
    words = ["1 s", "8 s", "40 s", "90 s", "3 min", "83 min", "2 h"]
    assert [*map(in_words, seconds)] == words


def test_more_spheres_take_longer_and_other_devices_are_not_guessed(capsys, monkeypatch):
    """The peaks are those that runs took, to a tenth: `make bench` has others."""
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    monkeypatch.setattr(pace, "choose_precision", lambda *_: "bfloat16")
    frame = osl.load_dataset("data_samples/sunny", split="test")[0]

    def said(method, *sizes):
        say_frame(method, frame, osl.SphereGrid(*sizes[:2], num_spheres=sizes[2]), "cpu")
        found = re.search("takes about (.+) and ([0-9.]+) GiB", capsys.readouterr().err)
        return found[1], pytest.approx(float(found[2]), rel=0.1)

    few, many = (said("volumenet", 640, 160, spheres) for spheres in (192, 960))
    assert few[1] == 0.72 and many[1] == 0.72 and few[0] != many[0]
    assert said("volumenet", 1600, 800, 64)[1] == 1.03
    assert said("zncc+sgm", 640, 320, 192)[1] == 1.03
    assert said("zncc+sgm", 1000, 250, 64)[1] == 0.84
    say_frame("volumenet", frame, osl.SphereGrid(640, 160), "cuda")
    assert capsys.readouterr().err == "method: volumenet on cuda\n"


@pytest.mark.parametrize("watched", [True, False], ids=["terminal", "log"])
def test_a_bar_names_the_parts_that_have_names(capsys, monkeypatch, watched):
    """A log has no bar for every part, since there each takes its own place."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: watched)
    bar = progress_bar()
    for _ in range(2):  # one after the other
        step = counted(bar, 2)
        step("camera 1 of 2")
        step("camera 2 of 2")
        step("")
    shown = capsys.readouterr().err
    assert "camera 1 of 2:   0%" in shown and ("camera 2 of 2:  50%" in shown) == watched
