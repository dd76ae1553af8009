"""What we write, opened by the programs that people use, and the page that says so."""

import functools
import http.server
import shutil
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

from omnistereo_lib import SphereGrid
from omnistereo_lib.pictures import read_image
from omnistereo_rigs.formats.camera_models import FISHEYE624, make_camera_model
from omnistereo_rigs.formats.read import read_any_rig
from omnistereo_tools.output.pictures import write_panorama
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


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "file"), [("anipose", "anipose.toml"), ("depthai", "oak.json")])
def test_what_other_programs_write_means_here_what_it_means_there(files, name, file):
    """Points of the first camera's frame, in the pixels of both cameras."""
    if peers.measure(name, files) is None:
        pytest.skip(f"{name} has no wheels for the Python versions that are here")
    rig = read_any_rig(files / file, "m" if name == "anipose" else None, keep_frame=True)
    truth = np.load(files / f"{name}.npz")
    for pose, camera, theirs in zip(rig.T_rig_cam, rig.cameras, truth["pixels"], strict=True):
        ours, valid = camera.project(pose.inverse() @ truth["points"])
        assert valid.mean() > 0.7
        np.testing.assert_allclose(ours[valid], theirs[valid], atol=0.02)


@pytest.mark.nightly
def test_fisheye624_is_that_of_project_aria(files):
    if peers.measure("aria", files) is None:
        pytest.skip("projectaria-tools has no wheels for the Python versions that are here")
    numbers, points, pixels = np.load(files / "aria.npz").values()
    stated = dict(zip(("fx", "cx", "cy", *FISHEYE624), numbers.tolist(), strict=True))
    ours, valid = make_camera_model("fisheye624", stated | {"fy": stated["fx"]})(points)
    assert valid.all()
    np.testing.assert_allclose(ours, pixels, atol=1e-6)


PAGES = {
    "mesh": """<script type="importmap">
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
</script>""",
    "pannellum": """<link rel="stylesheet" href="pannellum/build/pannellum.css">
<script src="pannellum/build/pannellum.js"></script>
<div id="show" style="height:200px"></div><script>
const viewer = pannellum.viewer("show", {
  type: "equirectangular", panorama: "panorama.jpg", autoLoad: true, showControls: false,
  hfov: 50, yaw: 60, pitch: Number(location.hash.slice(1))});
viewer.on("load", () => setTimeout(() => document.body.dataset.drawn = "yes", 500));
</script>""",
    "photo-sphere-viewer": """<link rel="stylesheet" href="core/index.css">
<script type="importmap">{"imports": {"three": "./three/build/three.module.js"}}</script>
<div id="show" style="height:200px"></div><script type="module">
import {Viewer} from "./core/index.module.js";
const viewer = new Viewer({
  container: "show", panorama: "panorama.jpg", navbar: false, defaultYaw: "60deg",
  defaultPitch: `${location.hash.slice(1)}deg`});
viewer.addEventListener("ready", () => setTimeout(() => document.body.dataset.drawn = "yes", 500));
</script>""",
}
NEEDED = {
    "mesh": ["three@0.180.0"],
    "pannellum": ["pannellum@2.5.7"],
    "photo-sphere-viewer": ["@photo-sphere-viewer/core@5.15.1", "three@0.185.1"],
}


def seen(page, kind, folder, fragment):
    """What a page shows, (200, 300, 3), served beside a file and the packages that it needs."""
    if shutil.which("npm") is None:
        pytest.skip("npm, which fetches the viewers, is not installed")
    for package in NEEDED[kind]:
        pack = ["npm", "pack", "--silent", package]
        done = subprocess.run(pack, cwd=folder, capture_output=True, text=True, check=True)
        subprocess.run(["tar", "xf", done.stdout.strip()], cwd=folder, check=True)
        (folder / "package").rename(folder / package.rsplit("@", 1)[0].split("/")[-1])
    body = f'<!doctype html><body style="margin:0">{PAGES[kind]}'
    (folder / "page.html").write_text(body)
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page.goto(f"http://127.0.0.1:{server.server_port}/page.html#{fragment}")
        page.wait_for_selector("body[data-drawn]")
        page.screenshot(path=str(folder / "shot.png"))
        server.shutdown()
    return read_image(folder / "shot.png").astype(int)


@pytest.mark.nightly
@pytest.mark.browser
@pytest.mark.parametrize("light", ["", "light"], ids=["dark", "lit"])
def test_a_mesh_looks_as_its_photographs_do_in_three(tmp_path, open_page, light):
    """Three walls, each of one colour, from the rig's place, with light and without."""
    colors = np.array([[200, 40, 20], [90, 90, 90], [12, 60, 250]], np.float32)
    wall = np.array([[-9, -3, 5], [-1, -3, 5], [-1, 3, 5], [-9, 3, 5]])
    places = np.concatenate([wall + np.array([8 * k - 3, 0, 0]) for k in range(3)])
    faces = np.concatenate([np.array([[0, 2, 1], [0, 3, 2]]) + 4 * k for k in range(3)])
    surface = Surface(places.astype(np.float32), faces, colors.repeat(4, 0))
    write_surface(tmp_path, surface)
    shot = seen(open_page(300, 200), "mesh", tmp_path, light)
    # Left, ahead and right, as the rig has them.
    for column, color in zip((30, 150, 270), colors, strict=True):
        assert np.abs(shot[100, column] - color).max() <= 2


@pytest.mark.nightly
@pytest.mark.browser
@pytest.mark.parametrize("viewer", ["pannellum", "photo-sphere-viewer"])
@pytest.mark.parametrize("up", [30, -30])
def test_viewers_show_a_part_of_the_sphere_where_it_is(tmp_path, open_page, viewer, up):
    """Red grows downwards by two a degree, green to the right by one for two."""
    grid = SphereGrid(360, 100, (-60, 40))
    down, right = np.meshgrid(np.arange(-59.5, 40), np.arange(-179.5, 180), indexing="ij")
    panorama = np.stack([128 + 2 * down, 128 + right / 2, 0 * down], -1)
    write_panorama(tmp_path / "panorama.jpg", panorama.round().astype(np.uint8), grid)
    shot = seen(open_page(300, 200), viewer, tmp_path, up)
    red, green, _ = shot[95:105, 145:155].mean((0, 1))
    assert abs((red - 128) / 2 + up) < 1.5 and abs(2 * (green - 128) - 60) < 3
