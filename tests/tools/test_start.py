"""The first ten minutes: a board that is printed in its size, and what lies in which folder."""

import re
from xml.etree import ElementTree

import pytest

from omnistereo_tools import cli

MM_PER_POINT = 25.4 / 72


def test_the_board_has_its_size_on_paper(tmp_path, capsys):
    out = tmp_path / "board.svg"
    assert cli.main(["board", str(out), "--board", "9x6", "--square", "0.025"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "--board 9x6 --square 0.025"
    root = ElementTree.parse(out).getroot()
    width, height = (float(root.get(side)[:-2]) * MM_PER_POINT for side in ("width", "height"))
    assert (width, height) == pytest.approx((297, 210), abs=0.01)  # A4
    assert "100 %, not “fit to page”" in out.read_text("utf-8")  # as a comment beside the outlines
    boxes, ends = [], []
    for path in root.iter("{http://www.w3.org/2000/svg}path"):
        numbers = [float(n) for n in re.findall(r"-?[0-9.]+", path.get("d") or "")]
        x, y = numbers[0::2], numbers[1::2]
        if numbers:
            boxes.append([(max(v) - min(v)) * MM_PER_POINT for v in (x, y)])
            if boxes[-1] == pytest.approx([25, 25], abs=0.01):
                ends += [min(x) * MM_PER_POINT, max(x) * MM_PER_POINT]
    squares = [box for box in boxes if box == pytest.approx([25, 25], abs=0.01)]
    assert len(squares) == 35  # of 10 x 7
    assert min(ends) + max(ends) == pytest.approx(width, abs=0.01)  # in the middle
    assert any(box == pytest.approx([100, 1], abs=0.01) for box in boxes)


def test_what_is_missing_is_named(tmp_path, capsys):
    command = ["start", str(tmp_path), "--board", "9x6", "--square", "0.025"]
    assert cli.main(command) == 2
    assert f"{tmp_path / 'boards'} is missing" in capsys.readouterr().err
    for camera in ("cam1", "cam2"):
        (tmp_path / "boards" / camera).mkdir(parents=True)
        (tmp_path / "boards" / camera / "1.png").write_bytes(b"")
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "cam1.png").write_bytes(b"")
    assert cli.main(command) == 2
    assert "scene has no image of cam2; found cam1.png" in capsys.readouterr().err
