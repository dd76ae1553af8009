"""What is said about durations."""

import sys

import pytest

import omnistereo_lib as osl
from omnistereo_lib.progress import counted
from omnistereo_tools.judge.pace import in_words, say_frame
from omnistereo_tools.progress import progress_bar


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.2, "1 s"),
        (8.4, "8 s"),
        (43, "40 s"),
        (89, "90 s"),
        (170, "3 min"),
        (5000, "83 min"),
        (9000, "2 h"),
    ],
)
def test_durations_in_words(seconds, words):
    assert in_words(seconds) == words


def test_more_spheres_take_longer_and_other_devices_are_not_guessed(capsys):
    for spheres in (192, 960):
        for method in ("volumenet", "zncc+sgm"):
            say_frame(method, osl.SphereGrid(640, 160, num_spheres=spheres), "cpu")
    say_frame("volumenet", osl.SphereGrid(2400, 1200), "cpu")
    say_frame("volumenet", osl.SphereGrid(640, 160), "cuda")
    first, smooth, second, much, large, other = capsys.readouterr().err.splitlines()
    assert first.startswith("volumenet takes about ") and first != second
    assert " and 0.9 GiB" in first and " and 0.9 GiB" in second and " and 2.0 GiB" in large
    assert smooth.endswith(" and 1.0 GiB") and much.endswith(" and 1.6 GiB")
    assert other == "method: volumenet on cuda"


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
