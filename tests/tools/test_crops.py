"""Perspective crops: what a pinhole at the camera sees of the box, its depth, its pose."""

import json

import cv2
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_rigs import read_any_rig
from omnistereo_tools.output.crops import crops_of, write_crops
from omnistereo_tools.output.points import Limits, PointCloud


@pytest.fixture(scope="module")
def rig():
    return scene.rig()


@pytest.fixture(scope="module")
def written(rig, tmp_path_factory):
    grid = osl.SphereGrid(320, 160, (-90, 90), num_spheres=64, min_depth=0.6)
    depth = scene.true_depth(rig, grid, scene.images(rig, finest=0.25))
    folder = tmp_path_factory.mktemp("crops")
    nothing = np.zeros(grid.shape, bool)
    cloud = PointCloud.of(depth, depth.panorama(), Limits(100.0, 0.0), nothing)
    assert write_crops(folder, depth, Limits(100.0, 0.0), cloud) == 20
    return folder


def test_each_crop_is_what_a_pinhole_sees(rig, written):
    transforms = json.loads((written / "transforms.json").read_text())
    assert transforms["camera_model"] == "PINHOLE" and len(transforms["frames"]) == 20
    center = np.mean([pose.t for pose in rig.T_rig_cam], 0)
    for frame in transforms["frames"][::10]:
        image = cv2.imread(str(written / frame["file_path"]), cv2.IMREAD_GRAYSCALE)
        z = cv2.imread(str(written / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED) / 1000
        assert z.shape == image.shape == (frame["h"], frame["w"])
        # The rays of an OpenGL camera: x right, y up, looking along -z.
        u, v = np.meshgrid(np.arange(frame["w"]) + 0.5, np.arange(frame["h"]) + 0.5)
        right, up = (u - frame["cx"]) / frame["fl_x"], -(v - frame["cy"]) / frame["fl_y"]
        rays = np.stack([right, up, -np.ones_like(u)], -1)
        matrix = np.array(frame["transform_matrix"])
        down = np.array([1, -1, -1])  # the world of the file has y up
        origin, directions = matrix[:3, 3] * down + center, rays @ matrix[:3, :3].T * down
        unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        distance = scene.distance(origin, unit)
        true_z = distance / np.linalg.norm(directions, axis=-1)
        known = z > 0
        assert known.mean() > 0.94
        assert np.quantile(np.abs(z / true_z - 1)[known], 0.95) < 0.02
        assert np.min(np.linalg.norm([pose.t - origin for pose in rig.T_rig_cam], axis=-1)) < 1e-9
        expected = scene.texture(origin + unit * distance[..., None], finest=0.25)
        inner = slice(20, -20)
        # of 255, interpolated
        assert np.abs(image[inner, inner] - expected[inner, inner]).mean() < 2


def test_the_crops_are_read_as_a_rig(written):
    rig = read_any_rig(written / "transforms.json", "m", keep_frame=True)
    frames = json.loads((written / "transforms.json").read_text())["frames"]
    u, v = 12.0, 30.0
    for camera, pose, frame in zip(rig.cameras, rig.T_rig_cam, frames, strict=True):
        ray = pose.R @ camera.unproject([u, v])[0]
        matrix = np.array(frame["transform_matrix"])
        right = (u + 0.5 - frame["cx"]) / frame["fl_x"]
        up = -(v + 0.5 - frame["cy"]) / frame["fl_y"]
        expected = matrix[:3, :3] @ [right, up, -1]
        np.testing.assert_allclose(
            ray / np.linalg.norm(ray), expected / np.linalg.norm(expected), atol=1e-4
        )
        np.testing.assert_allclose(pose.t, matrix[:3, 3], atol=1e-12)


def test_all_crops_have_a_mask_if_one_has(written):
    """As nerfstudio wants it; the first of each camera looks ahead and sees all of its pixels."""
    frames = json.loads((written / "transforms.json").read_text())["frames"]
    masks = [cv2.imread(str(written / f["mask_path"]), cv2.IMREAD_UNCHANGED) for f in frames]
    whole = [(mask == 255).all() for mask in masks]
    assert len(masks) == 20 and whole == [k % 5 == 0 for k in range(20)]


@pytest.mark.parametrize(("fov_deg", "count"), [(60, 1), (190, 5), (220, 5), (300, 6)])
def test_the_faces_of_a_cube_leave_nothing_out(fov_deg, count):
    lens, pose = scene.camera(200, 192, fov_deg), osl.Pose.from_vector([0.1, 2.0, 0.3, 0.2, 0, 0])
    crops = list(crops_of(lens, pose))
    assert len(crops) == count
    rays = np.random.default_rng(0).normal(size=(4000, 3))
    seen = rays[lens.project(rays)[1]]
    inside = np.zeros(len(seen), bool)
    for crop in crops:  # by the projection of a pinhole, written out
        x, y, z = (seen @ pose.R.T @ crop.T_rig_crop.R).T
        with np.errstate(divide="ignore"):
            u, v = crop.focal * x / z + crop.size / 2, crop.focal * y / z + crop.size / 2
        inside |= (z > 0) & (u >= 0) & (u <= crop.size) & (v >= 0) & (v <= crop.size)
    assert inside.all()
