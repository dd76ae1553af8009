"""Meshes, loaded by another program: on the walls, textured, cut at depth edges, y up."""

import json

import numpy as np
import pytest
import scene
from scene import refused

import omnistereo_lib as osl
from omnistereo_tools.output.mesh_export import make_mesh, write_mesh
from omnistereo_tools.output.points import Limits
from omnistereo_tools.world.page import write_surface
from omnistereo_tools.world.surface import Surface

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: environment.txt has it")

GRID = osl.SphereGrid(160, 40, num_spheres=64, min_depth=0.6)
RIG = scene.rig(width=200, height=192)
ALL = Limits(100.0, 0.0)


@pytest.fixture(scope="module")
def depth():
    return scene.true_depth(RIG, GRID)


@pytest.fixture(scope="module")
def panorama():
    """Red tells the column, green the row: a colour is a direction."""
    row, column = np.indices((80, 320))
    return np.stack([column * 255 // 319, row * 255 // 79, 0 * row], -1).astype(np.uint8)


def load(path):
    return trimesh.load(path, process=False, force="mesh")


def test_glb_is_textured_y_up_and_on_the_walls(depth, panorama, tmp_path):
    count, _ = write_mesh(tmp_path / "a.glb", depth, panorama, ALL)
    mesh = load(tmp_path / "a.glb")
    assert len(mesh.faces) == count == 2 * 39 * 160  # closed around the circle
    points = mesh.vertices * [1, -1, -1]
    np.testing.assert_allclose(scene.beyond_walls(points, RIG), 1, atol=1e-4)
    texture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
    np.testing.assert_array_equal(texture, panorama)
    u, v = mesh.visual.uv.T
    pixels, valid = GRID.project(points)
    assert valid.all() and u.max() > 1  # the copy of the first column
    off = (u - (pixels[:, 0] + 0.5) / 160 + 0.5) % 1 - 0.5
    np.testing.assert_allclose(off, 0, atol=1e-4)
    np.testing.assert_allclose(1 - v, (pixels[:, 1] + 0.5) / 40, atol=1e-4)
    assert np.ptp(u[mesh.faces], axis=1).max() < 0.02


def test_triangles_face_the_rig(depth):
    mesh = make_mesh(depth, ALL)
    assert ((mesh.face_normals * mesh.triangles_center).sum(-1) < 0).all()


def test_ply_has_the_colour_of_each_vertex(depth, panorama, tmp_path):
    write_mesh(tmp_path / "a.ply", depth, panorama, ALL)
    mesh = load(tmp_path / "a.ply")
    pixels, _ = GRID.project(mesh.vertices)
    expected = np.stack([(pixels[:, 0] + 0.5) / 160, (pixels[:, 1] + 0.5) / 40], -1) * 255
    np.testing.assert_allclose(mesh.visual.vertex_colors[:, :2], expected, atol=4)


def test_doubtful_triangles_are_marked_and_none_is_lost(depth, panorama, tmp_path):
    doubtful = np.zeros(GRID.shape, bool)
    doubtful[10:20, 50:70] = True
    count, marked = write_mesh(tmp_path / "a.glb", depth, panorama, ALL, doubtful=doubtful)
    parts = trimesh.load(tmp_path / "a.glb", process=False).geometry
    assert len(parts["surface"].faces) + len(parts["doubtful"].faces) == count == 2 * 39 * 160
    # with those that reach over, but for two corners
    assert len(parts["doubtful"].faces) == marked == 2 * 11 * 21 - 2
    pixels, _ = GRID.project(parts["doubtful"].vertices * [1, -1, -1])
    assert pixels.min(0).round().tolist() == [49, 9] and pixels.max(0).round().tolist() == [70, 20]
    look = parts["doubtful"].visual.material
    assert look.alphaMode == "BLEND" and look.baseColorFactor[3] < 128
    write_mesh(tmp_path / "a.ply", depth, panorama, ALL, doubtful=doubtful)
    ply = (tmp_path / "a.ply").read_bytes()
    assert b"property uchar doubtful" in ply.split(b"end_header")[0]
    stored = trimesh.load(tmp_path / "a.ply", process=False)
    found = stored.metadata["_ply_raw"]["vertex"]["data"]["doubtful"]
    pixels, _ = GRID.project(stored.vertices)
    column, row = pixels.round().astype(int).T
    np.testing.assert_array_equal(np.ravel(found), doubtful[row, column % 160])


def test_it_is_cut_where_the_depth_jumps_and_without_the_sky(depth):
    index = depth.index.copy()
    index[10:20, 50:70] = 50  # 0.75 m, before walls at more than a metre
    index[:5] = 0  # infinitely far
    index[30:, 90:] = np.nan
    mesh = make_mesh(osl.Depth(index, depth.confidence, depth.sweep), ALL)
    far = np.linalg.norm(mesh.vertices, axis=-1)[mesh.faces]
    assert np.ptp(far, axis=1).max() < 0.2 * far.min(1)[np.ptp(far, axis=1).argmax()] + 1e-9
    near = np.isclose(far, GRID.index_to_depth(50), rtol=1e-3).all(1)
    # a piece of its own, which ends half a ray farther
    assert near.sum() == 2 * 9 * 19 + 2 * 2 * (9 + 19) + 4
    pixels, _ = GRID.project(mesh.vertices[np.unique(mesh.faces[near])])
    np.testing.assert_allclose(
        [pixels.min(0), pixels.max(0)], [[49.5, 9.5], [69.5, 19.5]], atol=0.02
    )
    pixels, _ = GRID.project(mesh.vertices)
    assert pixels[:, 1].min() == pytest.approx(4.5, abs=0.02)  # below the sky
    area = np.abs(np.linalg.det(pixels[mesh.faces][:, [1, 2]] - pixels[mesh.faces][:, :1]))
    covered = area[np.ptp(pixels[mesh.faces][..., 0], axis=1) < 2].sum() / 2  # not across the seam
    assert covered == pytest.approx(34.5 * 159 - 9.5 * 69, abs=1)  # no gap between the two


def test_what_cannot_be_a_mesh_is_told(depth, panorama, tmp_path):
    with refused("no triangle is left"):
        write_mesh(tmp_path / "a.glb", depth, panorama, Limits(0.1, 0.0))
    assert not list(tmp_path.iterdir())


def test_glb_needs_no_light_and_has_a_camera_at_the_rig(depth, panorama, tmp_path):
    write_mesh(tmp_path / "a.glb", depth, panorama, ALL)
    tree = glb_tree(tmp_path / "a.glb")
    assert all("KHR_materials_unlit" in each["extensions"] for each in tree["materials"])
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    (eye,) = (node for node in tree["nodes"] if "camera" in node)
    assert eye == {"name": "rig", "camera": 0}
    assert tree["nodes"].index(eye) in tree["scenes"][0]["nodes"]


def glb_tree(path):
    content = path.read_bytes()
    return json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])


def test_a_world_has_linear_colours_in_glb(tmp_path):
    corners = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32)  # right, down, forward
    surface = Surface(corners, np.array([[0, 1, 2]]), np.full((3, 3), 128, np.float32))
    write_surface(tmp_path, surface)
    ply = trimesh.load(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(ply.vertices, corners)
    assert (ply.visual.vertex_colors[:, :3] == 128).all()
    tree = glb_tree(tmp_path / "mesh.glb")
    colors = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    # sRGB 128 is .2159 of the light of white
    assert colors["componentType"] == 5126
    assert colors["max"] == pytest.approx([0.21586] * 3, abs=1e-5)
