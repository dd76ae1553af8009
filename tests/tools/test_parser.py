"""Options: what is typed becomes a dataclass, and a dataclass what can be typed."""

from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest
from scene import refused

from omnistereo_tools.cli import COMMANDS, _parse
from omnistereo_tools.commands.depth_command import DepthOptions
from omnistereo_tools.commands.record_command import RecordOptions
from omnistereo_tools.parser import as_typed

RECORDING = (
    "record --rig r.yaml --images a.mp4 back --grid 320x80 --min-depth 2.5 --skip-bad --frames 7::2"
)


def test_words_become_values_of_the_types_declared():
    module, options = _parse(RECORDING.split())
    assert module is COMMANDS["record"] and isinstance(options, RecordOptions)
    given = {name: getattr(options, name) for name in options.given()}
    files = {"rig": Path("r.yaml"), "images": (Path("a.mp4"), Path("back"))}
    numbers = {"grid": "320x80", "min_depth": 2.5, "skip_bad": True, "frames": "7::2"}
    assert given == files | numbers
    assert options.sizes == (320, 80, 192) and options.chosen == (7, None, 2)
    with pytest.raises(FrozenInstanceError):
        options.grid = "9"


def test_options_become_the_words_of_another_command():
    images = (Path("a.mp4"), Path("the back"))
    options = DepthOptions(
        rig=Path("r"), images=images, strict=True, min_depth=0.55, mesh=Path("a.glb")
    )
    assert (
        as_typed("record", RecordOptions, options, grid="320")
        == "omnistereo record --rig r --grid 320 --min-depth 0.55 --strict --images a.mp4 'the back'"
    )


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"max_depth": -1.0}, "--max-depth is -1.0; expected a number above 0"),
        ({"mesh": Path("a.obj")}, "a.obj has the wrong suffix; expected .glb or .ply"),
        ({"images": (Path("1.png"),)}, "--images needs --rig"),
    ],
)
def test_options_that_cannot_be_are_refused_without_a_parser(values, said):
    with refused(said):
        DepthOptions(**values)
