"""Nothing that a command reads is written over: each option that writes is tried."""

import os
from typing import get_type_hints

import pytest
from scene import refused

from omnistereo_tools import cli
from omnistereo_tools.outputs import READ, hold, let_go

WRITES = ("out", "mesh", "equirectangular", "crops", "las", "video", "write")
FILES = {
    "rig.yaml": "cameras: [{invalid_mask: dark.png}]",
    **dict.fromkeys((f"1.{suffix}" for suffix in ("las", "ply", "tiff")), "image"),
    **dict.fromkeys((f"{name}.png" for name in (2, 3, 4, "dark", "overview", "mask")), "image"),
    **dict.fromkeys(("data/points.png", "crops/images/1.png", "crops/transforms.json"), "image"),
    **dict.fromkeys(
        ("front.mp4", "back.mp4", "drive/cam1/1.png", "drive/cam2/1.png", "drive/video/1.png"),
        "image",
    ),
    "drive/config.yaml": "cameras: []",
    "drive/recording.json": "{}",
    "own/config.yaml": "cameras: []",
    "set/config.yaml": "dataset: {truth: ../truth}",
    **dict.fromkeys(("set/cam1/1.png", "set/cam2/1.png", "set/omnidepth_gt_640/1.tiff"), "image"),
    **dict.fromkeys(
        ("boards/cam1/1.png", "boards/cam2/1.png", "rig/config.yaml", "rig/report.txt"), "image"
    ),
    **dict.fromkeys(
        ("run/index.html", "run/weights.safetensors", "tables/results.json", "network/run_onnx.py"),
        "text",
    ),
}
FRAME = "depth --rig rig.yaml --images 1.tiff 2.png 3.png"
BOARDS = "calibrate boards --square 0.1 --board 5x4"
COMMANDS = [
    f"{FRAME} --equirectangular 1.tiff",
    f"{FRAME} --equirectangular linked.tiff",
    f"{FRAME} --equirectangular same.tiff",
    f"{FRAME} --equirectangular set/../1.tiff",
    "depth --rig rig.yaml --images 1.ply 2.png --mesh 1.ply",
    "depth --rig rig.yaml --images 1.las 2.png --las 1.las",
    "depth --rig rig.yaml --images overview.png 2.png --out .",
    "depth --rig rig.yaml --images 1.tiff 2.png --beside run --out run",
    "depth --rig rig.yaml --images data/points.png 2.png --out .",
    "depth --rig rig.yaml --images crops/images/1.png 2.png --crops crops",
    "depth --rig crops/transforms.json --images 1.tiff 2.png --crops crops",
    "depth --rig set --equirectangular set/omnidepth_gt_640/1.tiff",
    "record --rig rig.yaml --images front.mp4 back.mp4 --video front.mp4",
    "record --rig rig.yaml --images drive/cam1 drive/cam2 --out drive",
    "record --rig rig.yaml --images drive/video front.mp4 --out drive",
    "record --rig drive/config.yaml --images front.mp4 back.mp4 --out drive",
    "world own",
    "doctor --rig rig.yaml --images 2.png 3.png --write rig.yaml",
    f"{BOARDS} --out boards",
    f"{BOARDS} --out boards/cam1",
    f"{BOARDS} --out rig --rig rig/config.yaml",
    "calibrate boards --board rig/config.yaml --out rig",
    "calibrate --from-images 2.png 3.png --rig rig/config.yaml --out rig",
    "calibrate --from-images 2.png 3.png --rig rig/config.yaml --baseline 0.3 --out rig",
    "train volumenet --init-weights run/weights.safetensors --out run",
    "evaluate --sets set --rig tables/results.json --out tables",
    "onnx --rig network/run_onnx.py --out network",
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "linked.tiff").symlink_to("1.tiff")
    (tmp_path / "own" / "world").symlink_to(".")
    os.link(tmp_path / "1.tiff", tmp_path / "same.tiff")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_read_is_not_written_over(folder, capsys, command):
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert cli.main(command.split()) == 2
    said = capsys.readouterr().err
    assert "would write over it" in said or "would be read as images" in said
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    "command",
    [
        f"{FRAME} --out out --equirectangular out/data/inverse_depth.tiff",
        f"{FRAME} --out out --equirectangular out/data/../data/inverse_depth.tiff",
        f"{FRAME} --out 5.glb --mesh 5.glb",
        "record --rig rig.yaml --images front.mp4 back.mp4 --out new --video new/video/a.mp4",
    ],
)
def test_no_output_is_written_over_another(folder, capsys, command):
    assert cli.main(command.split()) == 2
    assert "would both be written by this command" in capsys.readouterr().err
    assert not any((folder / name).exists() for name in ("out", "new", "c", "5.glb"))


def test_every_option_that_is_a_path_is_read_or_tried_here():
    paths = set()
    for module in cli.COMMANDS.values():
        hints = get_type_hints(get_type_hints(module.run)["options"])
        paths |= {name for name, hint in hints.items() if "Path" in str(hint)}
    # these may be no files
    assert paths == {*READ, *WRITES} - {"board", "sets"}
    assert all(any(f" --{name} " in command for command in COMMANDS) for name in WRITES)


@pytest.mark.skipif(os.name != "posix", reason="Windows has no locks of folders")
def test_a_folder_that_another_run_holds_is_refused_until_it_lets_go(tmp_path):
    hold(tmp_path / "out")
    with refused("another run is writing into"):
        hold(tmp_path / "out")
    let_go()
    assert list(hold(tmp_path / "out").iterdir()) == []
    let_go()
