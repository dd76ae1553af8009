"""What we write, opened by the programs that people use, each installed by the test; and the page
that says so."""

import functools
import http.server
import shutil
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

from omnistereo_lib.pictures import read_image
from omnistereo_tools.world.page import write_surface
from omnistereo_tools.world.surface import Surface
from workshop.peers import __main__ as peers

PAGE = Path(peers.PAGE).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return peers.make_files(tmp_path_factory.mktemp("files"))


@pytest.mark.nightly
@pytest.mark.parametrize("name", peers.PROGRAMS)
def test_our_files_mean_in_other_programs_what_they_mean_here(files, name):
    if (rows := peers.measure(name, files)) is None:
        pytest.skip(f"{name} has no wheels for the Python versions that are here")
    wrong = [row for row in rows["files"] if not row[3] <= row[4]]
    assert not wrong
    for row in rows["lenses"]:
        assert f"| {' | '.join(row)} |" in PAGE, "behaves otherwise than the page says"


def test_the_page_has_thirty_lenses_and_no_file_that_is_read_wrongly():
    lenses, files = (PAGE.split(f"## {part}")[1].split("##")[0] for part in ("Lenses", "Our files"))
    assert lenses.count("\n| ") >= 31
    rows = [row.split(" | ") for row in files.strip().splitlines()[4:]]
    assert len(rows) >= 20 and all(float(row[-2]) <= float(row[-1].strip(" |")) for row in rows)


SHOW = """<!doctype html><body style="margin:0"><script type="importmap">
{"imports": {"three": "./three/build/three.module.js", "three/addons/": "./three/examples/jsm/"}}
</script><script type="module">
import * as THREE from "three";
import {GLTFLoader} from "three/addons/loaders/GLTFLoader.js";
const renderer = new THREE.WebGLRenderer({preserveDrawingBuffer: true});
renderer.setSize(300, 200);
document.body.appendChild(renderer.domElement);
const gltf = await new GLTFLoader().loadAsync("mesh.glb");
const scene = new THREE.Scene();
scene.add(gltf.scene);
if (location.hash) scene.add(new THREE.AmbientLight(0xffffff, Math.PI));
const camera = gltf.cameras[0];
camera.aspect = 1.5;
camera.updateProjectionMatrix();
renderer.render(scene, camera);
document.body.dataset.drawn = "yes";
</script>"""


@pytest.mark.nightly
@pytest.mark.browser
@pytest.mark.parametrize("light", ["", "#light"], ids=["dark", "lit"])
def test_a_mesh_looks_as_its_photographs_do_in_three(tmp_path, open_page, light):
    """Three walls, each of one colour, from the rig's place, with light and without."""
    if shutil.which("npm") is None:
        pytest.skip("npm, which fetches three.js, is not installed")
    pack = ["npm", "pack", "--silent", "three@0.180.0"]
    archive = subprocess.run(pack, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    subprocess.run(["tar", "xf", archive.strip()], cwd=tmp_path, check=True)
    (tmp_path / "package").rename(tmp_path / "three")
    colors = np.array([[200, 40, 20], [90, 90, 90], [12, 60, 250]], np.float32)
    corners = [[-9, -3, 5], [-1, -3, 5], [-1, 3, 5], [-9, 3, 5]]
    wall = np.array(corners)
    places = np.concatenate([wall + np.array([8 * k - 3, 0, 0]) for k in range(3)])
    faces = np.concatenate([np.array([[0, 2, 1], [0, 3, 2]]) + 4 * k for k in range(3)])
    surface = Surface(places.astype(np.float32), faces, colors.repeat(4, 0))
    write_surface(tmp_path, surface)
    (tmp_path / "page.html").write_text(SHOW)
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=tmp_path)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page = open_page(300, 200)
        page.goto(f"http://127.0.0.1:{server.server_port}/page.html{light}")
        page.wait_for_selector("body[data-drawn]")
        page.screenshot(path=str(tmp_path / "shot.png"))
        server.shutdown()
    shot = read_image(tmp_path / "shot.png").astype(int)
    # Left, ahead and right, as the rig has them.
    for column, color in zip((30, 150, 270), colors, strict=True):
        assert np.abs(shot[100, column] - color).max() <= 2
