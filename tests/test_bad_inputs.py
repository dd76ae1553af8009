"""Every bad input is answered: the table in `bad_inputs`, row by row."""

import re
import shutil

import bad_inputs
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_tools import cli


def by_wrong(rows):
    return pytest.mark.parametrize("row", rows, ids=[row.wrong for row in rows])


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    grid = osl.SphereGrid(96, 24, (-45, 45), 16, 0.6)
    return scene.write_set(
        tmp_path_factory.mktemp("bad") / "data", bad_inputs.RIG, grid, [(0, 0, 0)]
    )


@pytest.fixture
def data(original, tmp_path):
    shutil.copytree(original, tmp_path / "data")
    (tmp_path / "data" / "boards").mkdir()
    return tmp_path / "data"


def words(row, data):
    images = " ".join(str(bad_inputs.first(data, camera)) for camera in (1, 2, 3, 4))
    places = {
        "DATA": data,
        "RIG": data / "config.yaml",
        "IMAGES": images,
        "OUT": data.parent / "out",
        "BOARDS": data / "boards",
        "LONG": data / (300 * "n"),
    }
    return re.sub("|".join(places), lambda word: str(places[word[0]]), row.command).split()


def run(row, data):
    """Spoil the data and run the command; return the exit status and what stood in the folder
    before."""
    row.spoil(data)
    command, before = words(row, data), sorted(data.rglob("*"))
    try:
        return cli.main(command), before
    except SystemExit as stop:  # of argparse
        return stop.code, before


@by_wrong(bad_inputs.COMMANDS)
def test_a_command_is_answered_in_one_line(row, data, capsys):
    code, before = run(row, data)
    err = capsys.readouterr().err
    _, _, answer = err.partition("error: ")
    lines = answer.rstrip().splitlines()
    assert code == 2 and "Traceback" not in err
    assert re.search(row.said, answer), err
    assert len(lines) == 1 and len(answer) <= 501
    assert "error: " not in answer and answer.count("cannot be read") < 2  # nothing is said twice
    assert sorted(data.rglob("*")) == before
    assert [path.name for path in data.parent.iterdir()] == ["data"]


@pytest.mark.usefixtures("small")
def test_what_computes_but_can_mean_nothing_is_doubted(data, capsys):
    row = bad_inputs.Row(
        "swapped", bad_inputs.DEPTH + "--min-depth 0.01", "", bad_inputs.two_pictures_swapped
    )
    assert run(row, data)[0] == 0
    said = capsys.readouterr().err
    assert re.search(
        r"warning: the cameras are .* the spheres begin at 0.01 m, inside the rig", said
    )
    assert re.search(r"warning: the images look swapped \(give them in the order 2 1 3 4\)", said)


@by_wrong(bad_inputs.BOMBS)
def test_a_bomb_is_refused_with_five_seconds_and_a_gigabyte(row, data, limits):
    row.spoil(data)
    limits(memory=1 << 30)
    with pytest.raises(osl.OmnistereoError, match=row.said):
        row.load(data)


@by_wrong(bad_inputs.CALLS)
def test_a_call_raises_our_error(row, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(osl.OmnistereoError, match=row.said):
        row.call()


def test_gray_and_colour_pictures_mixed(data):
    pictures = osl.load_images([bad_inputs.first(data, camera) for camera in (1, 2, 3, 4)])
    mixed = [np.stack([pictures[0]] * 3, -1), *pictures[1:]]
    panorama = bad_inputs.depth(mixed).panorama()
    assert panorama.shape == (24, 96, 3)
    np.testing.assert_allclose(panorama[..., 0], bad_inputs.depth(pictures).panorama(), atol=1e-3)
