"""The ledger in its file: between its markers, and by the command line."""

import pytest
import scene
from test_ledger import record

import omnistereo_lib as osl
from course import findings, ledger
from course.__main__ import main
from course.ledger import MARKERS, split_at_markers, write_ledger
from omnistereo_lib import cli
from omnistereo_lib.evaluate import SCALES, Scale

OPEN, CLOSE = MARKERS


def test_only_what_is_between_the_markers_is_replaced(tmp_path):
    path = tmp_path / "README.md"
    head, tail = f"# Tïtle\r\n\r\n{OPEN}", f"{CLOSE}\n\ntail without a newline"
    path.write_bytes(f"{head}\nold\n{tail}".encode())
    write_ledger(path, record())
    expected = f"{head}\n{ledger.ledger(record())}{tail}"
    assert path.read_bytes().decode() == expected
    write_ledger(path, record())
    assert path.read_bytes().decode() == expected
    assert split_at_markers(path) == (head, tail) and list(tmp_path.iterdir()) == [path]
    write_ledger(path)
    assert "no results were given" in path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "counts"),
    [("# Nothing\n", "0 × .* 0 × "), (f"{OPEN}\n", "1 × .* 0 × "), (f"{CLOSE}\n{OPEN}\n", "1 × .* 1 × "),
     (f"{OPEN}\n{CLOSE}\n{OPEN}\n", "2 × .* 1 × ")],
    ids=["none", "no end", "wrong order", "two"],
)  # fmt: skip
def test_files_without_their_markers_are_named_and_left_alone(tmp_path, text, counts):
    path = tmp_path / "README.md"
    path.write_text(text)
    with pytest.raises(osl.OmnistereoError, match=rf"README.md holds {counts}.*: expected one line of each"):
        write_ledger(path)
    assert path.read_text() == text and list(tmp_path.iterdir()) == [path]


def test_files_that_are_no_text(tmp_path):
    with pytest.raises(osl.OmnistereoError, match=r"none.md cannot be read"):
        write_ledger(tmp_path / "none.md")
    (tmp_path / "picture.md").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(osl.OmnistereoError, match=r"picture.md is no text in UTF-8"):
        write_ledger(tmp_path / "picture.md")


@pytest.fixture
def sunny(tmp_path):
    """One frame of the box in a folder that is called as the paper's set is."""
    grid = osl.SphereGrid(48, 12, (-45, 45), 8, 0.6)
    return scene.write_set(tmp_path / "sunny", scene.rig(width=200, height=192), grid, [(0, 0, 0)])


def test_the_command_line_updates_the_ledger(sunny, tmp_path, monkeypatch):
    monkeypatch.setitem(SCALES, "paper", Scale(48, 12, 8))
    monkeypatch.setattr(findings, "PAPER_SCALE", "48 × 12, N = 8")
    readme = tmp_path / "README.md"
    readme.write_text(f"# Title\n{OPEN}\n{CLOSE}\n")
    words = ["--sets", sunny, "--methods", "zncc", "zncc+sgm", "--scale", "paper", "--out", tmp_path / "out"]
    assert cli.main(["evaluate", *map(str, words)]) == 0
    assert main(["ledger", str(readme), "--results", str(tmp_path / "out" / "results.json")]) == 0
    text = readme.read_text(encoding="utf-8")
    assert "frames 1 of sunny; 48 × 12, N = 8" in text and "| ZNCC + SGM, Sunny |" in text
    row = next(line for line in text.splitlines() if line.startswith("| ZNCC + SGM, Sunny |"))
    assert "not evaluated" not in row and row.count("÷ ZNCC") == 2
    assert "no ZNCC on cloudy" in text


def test_a_file_without_markers_is_refused(tmp_path, capsys):
    readme = tmp_path / "README.md"
    readme.write_text("# Title\n")
    assert main(["ledger", str(readme)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {readme} holds 0 × {OPEN} and 0 × {CLOSE}")
