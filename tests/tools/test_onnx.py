"""VolumeNet by ONNX Runtime: the same numbers as torch's, in a process that has no torch."""

import io
import runpy
import subprocess
import sys
from contextlib import redirect_stdout
from importlib.util import find_spec

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.pictures import write_image
from omnistereo_lib.stereo import correlation
from omnistereo_lib.stereo.volumenet import local_mean
from omnistereo_tools import cli

pytestmark = pytest.mark.skipif(
    find_spec("onnxruntime") is None, reason="environment-dev.txt has ONNX Runtime"
)

FINE = ["--grid", "160x40x128"]  # two volumes
GRID = osl.SphereGrid(160, 40, num_spheres=128, min_depth=0.6)


@pytest.fixture(scope="module", autouse=True)
def small_volume():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(correlation, "COARSE", (32, 8))
        yield


@pytest.fixture(scope="module")
def rig():
    cameras = scene.rig(width=200, height=192)
    return osl.Rig(cameras.cameras, cameras.T_rig_cam, min_depth=0.6)


@pytest.fixture(scope="module")
def exported(rig, tmp_path_factory):
    """The folder that the command has written, whose name has a blank."""
    folder = tmp_path_factory.mktemp("onnx")
    osl.save_rig(rig, folder / "rig.yaml")
    with redirect_stdout(io.StringIO()) as said:
        assert (
            cli.main(
                ["onnx", "--rig", str(folder / "rig.yaml"), *FINE, "--out", str(folder / "my out")]
            )
            == 0
        )
    # as a shell takes it
    assert said.getvalue().endswith(
        f"\npython '{folder}/my out/run_onnx.py' 1.png 2.png 3.png 4.png\n"
    )
    return folder / "my out"


# Runs the script where there is neither torch nor this library.
ALONE = (
    "import runpy, sys; sys.modules['torch'] = sys.modules['omnistereo_lib'] = None; sys.argv ="
    " sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
)


def test_depth_without_torch(exported, rig, tmp_path):
    images = []
    for k, picture in enumerate(scene.images(rig, finest=0.25)):
        color = np.stack([picture, 0.5 * picture, 255 - picture], -1).astype(np.uint8)
        images.append(color)
        write_image(tmp_path / f"{k}.png", color)
    words = [exported / "run_onnx.py", *(tmp_path / f"{k}.png" for k in range(4))]
    out = "--out", tmp_path / "a.npy"
    subprocess.run([sys.executable, "-c", ALONE, *words, *out], check=True)
    network = osl.VolumeNet.pretrained()
    network.precision = "float32"
    expected = GRID.index_to_inverse_depth(
        local_mean(osl.cost_volume(osl.SphereSweep(rig, GRID), images, network))[0]
    )
    np.testing.assert_allclose(np.load(tmp_path / "a.npy"), expected, atol=1e-3 / 0.6)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["right.png"] * 3, "there are 3 images for 4 cameras"),
        (
            ["right.png"] * 3 + ["small.png"],
            "small.png is 100 × 192 px; the camera has 200 × 192 px",
        ),
        (["none.png"] * 4, "none.png cannot be read as an image"),
    ],
)
def test_the_script_says_in_one_line_what_is_wrong(exported, tmp_path, monkeypatch, names, said):
    write_image(tmp_path / "right.png", np.zeros((192, 200)))
    write_image(tmp_path / "small.png", np.zeros((192, 100)))
    words = [exported / "run_onnx.py", *(tmp_path / name for name in names)]
    monkeypatch.setattr(sys, "argv", [*map(str, words), "--out", str(tmp_path / "a.npy")])
    with pytest.raises(SystemExit, match=f"^error: .*{said}[^\n]*$"):
        runpy.run_path(sys.argv[0], run_name="__main__")
    assert not (tmp_path / "a.npy").exists()
