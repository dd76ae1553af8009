"""Every bad input is answered: the table in `bad_inputs`, row by row."""

import re
import shutil
from pathlib import Path

import bad_inputs
import numpy as np
import pytest
import scene
import yaml
from scene import refused

import omnistereo_lib as osl
from omnistereo_tools import cli

COMMANDS = yaml.safe_load(Path(bad_inputs.__file__).with_suffix(".yaml").read_text("utf-8"))
ROWS = [
    pytest.param(command, row, id=f"{command.split()[0]}: {wrong}")
    for command, rows in COMMANDS.items()
    for wrong, row in rows.items()
]


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


def run(command, row, data):
    """Spoil the data, run the command; return exit status and what the folder held before."""
    for how, value in row.items():
        if how not in ("add", "said"):
            getattr(bad_inputs, how)(data, value)
    places = {
        "DATA": data,
        "RIG": data / "config.yaml",
        "IMAGES": " ".join(str(bad_inputs.first(data, camera)) for camera in (1, 2, 3, 4)),
        "VIDEOS": " ".join(str(data / f"cam{camera}") for camera in (1, 2, 3, 4)),
        "OUT": data.parent / "out",
        "BOARDS": data / "boards",
        "LONG": data / (300 * "n"),
    }
    words = f"{command.removeprefix('omnistereo')} {row.get('add', '')}"
    words = re.sub("|".join(places), lambda word: str(places[word[0]]), words).split()
    before = sorted(data.rglob("*"))
    try:
        return cli.main(words), before
    except SystemExit as stop:  # of argparse
        return stop.code, before


@pytest.mark.parametrize(("command", "row"), ROWS)
def test_a_command_is_answered_in_one_line(command, row, data, capsys):
    code, before = run(command, row, data)
    err = capsys.readouterr().err
    _, _, answer = err.partition("error: ")
    lines = answer.rstrip().splitlines()
    assert code == 2 and "Traceback" not in err
    assert re.search(row["said"], answer), err
    assert len(lines) == 1 and len(answer) <= 501
    assert "error: " not in answer and answer.count("cannot be read") < 2  # nothing is said twice
    assert sorted(data.rglob("*")) == before
    assert [path.name for path in data.parent.iterdir()] == ["data"]


@pytest.mark.usefixtures("small")
def test_what_computes_but_can_mean_nothing_is_doubted(data, capsys):
    depth = next(command for command in COMMANDS if command.startswith("depth"))
    assert run(depth, {"add": "--min-depth 0.01 --phi -0.8 0.8"}, data)[0] == 0
    said = capsys.readouterr().err
    assert re.search(
        r"warning: the cameras are .* the spheres begin at 0.01 m, inside the rig", said
    )
    assert "--phi -0.8 0.8 are degrees, a strip of 1.6°: no radians" in said


@pytest.mark.parametrize("bomb", bad_inputs.BOMBS)
def test_a_bomb_is_refused_with_five_seconds_and_a_gigabyte(bomb, data, limits):
    load, said, spoil = bad_inputs.BOMBS[bomb]
    spoil(data)
    limits(memory=1 << 30)
    with refused(said):
        load(data)


@pytest.mark.parametrize(("call", "said"), bad_inputs.CALLS, ids=lambda x: x if str(x) == x else "")
def test_a_call_raises_our_error(call, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with refused(said):
        call()


def test_gray_and_colour_pictures_mixed(data):
    pictures = osl.load_images([bad_inputs.first(data, camera) for camera in (1, 2, 3, 4)])
    mixed = [np.stack([pictures[0]] * 3, -1), *pictures[1:]]
    panorama = bad_inputs.depth(mixed).panorama()
    assert panorama.shape == (24, 96, 3)
    np.testing.assert_allclose(panorama[..., 0], bad_inputs.depth(pictures).panorama(), atol=1e-3)
