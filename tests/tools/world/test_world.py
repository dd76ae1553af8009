"""A recording becomes one world: each part against a closed form."""

from dataclasses import replace

import numpy as np
import pytest
import scene
from scene import refused
from scipy.spatial.transform import Rotation

import omnistereo_lib as osl
from omnistereo_lib.geometry.trajectory import read_trajectory, trajectory_tum
from omnistereo_rigs.images.features import FeatureFinder
from omnistereo_tools.world.build import jumps_past_others
from omnistereo_tools.world.fusion import View, Volume, bytes_needed, touched_blocks
from omnistereo_tools.world.motion import SightingFinder, rig_step
from omnistereo_tools.world.refine import mix, moving_rays
from omnistereo_tools.world.surface import choose_views, extract_surface, seen_surface

GRID = osl.SphereGrid(320, 160, (-90.0, 90.0), num_spheres=64, min_depth=0.5)
RADIUS, VOXEL, REACH = 3.0, 0.1, 10.0
T_A_B = osl.Pose.from_vector([0.05, 0.2, -0.03, 0.4, 0.1, 0.5])


def in_sphere(place):
    """The distance from inside a sphere around the origin to its wall, along rig rays."""
    along = GRID.rays() @ place
    return np.sqrt(along**2 + RADIUS**2 - place @ place) - along


def view(place, depth):
    ones = np.ones(depth.shape)
    return View.of(osl.Pose(np.eye(3), place), 1 / depth, ones, 100 * ones, 0.01)


def fused(views):
    keys = np.unique(np.concatenate([touched_blocks(one, GRID, VOXEL, REACH) for one in views]))
    volume = Volume(keys, VOXEL, REACH, 1)
    for one in views:
        volume.integrate(one, GRID)
    return volume


@pytest.fixture(scope="module")
def sphere():
    places = [np.array(place) for place in ([0.3, 0.0, 0.2], [-0.4, 0.1, 0.0])]
    return fused([view(place, in_sphere(place)) for place in places])


@pytest.fixture(scope="module")
def sightings():
    """Two frames of a rig in the box: images and exact depth, before and after a step."""
    rig = scene.rig(width=400, height=384).recentered()
    finder, found = SightingFinder(rig, GRID), []
    for T in (osl.Pose.identity(), T_A_B):
        images = [
            picture.astype(np.uint8) for picture in scene.images(rig.transformed(T), finest=0.12)
        ]
        depth = scene.distance(T.t, GRID.rays() @ T.R.T)
        found.append(finder.find(images, (1 / depth).astype(np.float32)))
    return rig, *found


def test_the_step_of_the_rig_is_found_without_a_guess_and_with_a_wrong_one(sightings):
    rig, a, b = sightings
    for last in (None, osl.Pose.from_vector([0, 0, 0, 0, 0, -0.5])):
        step = rig_step(rig, a, b, last)
        angle, length = (T_A_B.inverse() @ step.T).magnitude()
        assert step.sure and angle < 0.05 and length < 0.005


def test_errors_of_the_depth_do_not_shorten_the_step(sightings):
    """Thousands of inverse distances are off by a tenth; taken as exact they cost 0.06 %."""
    rig, *both = sightings
    rng, noisy = np.random.default_rng(0), []
    for one in both:
        sd = [0.1 * inverse for inverse in one.inverse]
        inverse = [q + s * rng.normal(size=len(q)) for q, s in zip(one.inverse, sd, strict=True)]
        noisy.append(replace(one, inverse=inverse, sd=sd))
    step = rig_step(rig, *noisy, T_A_B)
    assert step.T.t @ T_A_B.t / (T_A_B.t @ T_A_B.t) == pytest.approx(1, abs=3e-4)


def test_frames_of_different_places_give_no_sure_step(sightings):
    rig, a, _ = sightings
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 255, camera.image_size[::-1], np.uint8) for camera in rig.cameras]
    assert not rig_step(
        rig, a, SightingFinder(rig, GRID).find(noise, np.full(GRID.shape, 0.3, np.float32))
    ).sure


@pytest.mark.slow
def test_a_step_on_which_only_what_is_far_agrees_is_not_sure():
    data = osl.load_dataset("data_samples/drive/test")
    grid = osl.SphereGrid(640, 160, min_depth=1.65)
    rig = data.rig.recentered()
    finder = SightingFinder(rig, grid)
    first, near, far = (finder.find(data[k].images, data[k].inverse_depth) for k in (0, 6, 9))
    step, beyond = rig_step(rig, first, near), rig_step(rig, first, far)
    assert step.sure and step.T.t[2] == pytest.approx(8.4, abs=0.2)
    # 12.7 m in truth
    assert beyond.T.t[2] < 6 and beyond.inliers > 700 and not beyond.sure


def test_depth_read_back_is_the_distance_to_the_surface(sphere):
    place = np.array([0.0, -0.2, 0.5])  # no frame was here
    inverse, color = sphere.march(osl.Pose(np.eye(3), place), GRID.rays(), REACH)
    np.testing.assert_allclose(1 / inverse, in_sphere(place), atol=VOXEL / 10)
    np.testing.assert_allclose(color, 100, rtol=1e-5)


def test_the_mesh_is_closed_and_lies_on_the_surface(sphere):
    trimesh = pytest.importorskip("trimesh")
    surface = extract_surface(sphere)
    np.testing.assert_allclose(np.linalg.norm(surface.vertices, axis=1), RADIUS, atol=VOXEL / 10)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.is_watertight
    # it faces the rig, which is inside
    assert mesh.volume == pytest.approx(-4 / 3 * np.pi * RADIUS**3, rel=0.01)


def test_a_triangle_is_coloured_by_the_frame_that_shows_it_largest(sphere):
    surface, places = extract_surface(sphere), np.array([[0.0, 0, 2], [0, 0, -2]])
    views = []
    for place in places:
        inverse = (1 / in_sphere(place)).astype(np.float32)
        inverse[:, :40] = 4  # something is nearer there
        views.append((osl.Pose(np.eye(3), place), inverse))
    chosen = choose_views(surface, views, GRID)
    middle = surface.vertices[surface.faces].mean(axis=1)
    away = np.linalg.norm(middle - places[:, None], axis=-1)
    hidden = np.stack([GRID.project(middle - place)[0][:, 0] < 38 for place in places])
    clear = ~hidden.any(0) & (np.abs(away[0] - away[1]) > 1)
    assert (chosen[clear] == (away[1] < away[0])[clear]).mean() > 0.98
    assert (chosen[hidden.all(0)] == -1).all() and hidden.all(0).sum() > 100
    kept = seen_surface(surface, views, GRID)
    kept = kept.vertices[kept.faces].mean(axis=1)
    np.testing.assert_array_equal(kept, middle[chosen >= 0])


def test_what_other_frames_see_through_is_carved():
    depth, place = in_sphere(np.zeros(3)), np.zeros(3)
    # in front of the wall, once in four frames
    wrong = np.where(GRID.rays()[..., 2] > 0.9, 2.0, depth)
    volume = fused([view(place, wrong), *[view(place, depth)] * 3])
    inverse, _ = volume.march(osl.Pose.identity(), GRID.rays(), REACH)
    np.testing.assert_allclose(1 / inverse, RADIUS, atol=VOXEL / 10)


def test_a_far_surface_carves_as_surely_as_a_near_one():
    """A car 3 m away is seen once; beyond it the way is free up to a wall of unsure distance."""
    depth, place = np.full(GRID.shape, 9.0), np.zeros(3)
    volume = fused([view(place, in_sphere(place)), *[view(place, depth)] * 2])
    inverse, _ = volume.march(osl.Pose.identity(), GRID.rays(), REACH)
    assert np.nanmax(inverse) < 1 / 5


def test_a_view_that_is_taken_out_again_leaves_what_the_others_saw():
    depth, place = in_sphere(np.zeros(3)), np.zeros(3)
    car = view(place, np.where(GRID.rays()[..., 2] > 0.9, 2.0, depth))
    volume = fused([car, view(place, depth)])
    volume.integrate(replace(car, weight=-car.weight), GRID)
    inverse, _ = volume.march(osl.Pose.identity(), GRID.rays(), REACH)
    np.testing.assert_allclose(1 / inverse, RADIUS, atol=VOXEL / 10)


def test_blocks_that_are_passed_over_get_nothing(monkeypatch):
    """Of a view whose ray is used in one corner, beside a near thing that hides much."""
    one = view(np.zeros(3), np.where(GRID.rays()[..., 0] > 0.8, 1.0, in_sphere(np.zeros(3))))
    some = replace(one, weight=np.where(np.arange(320) < 90, one.weight, 0))
    passed_over = fused([one, some])
    assert len(passed_over._reached(some, GRID)) < len(passed_over.voxels[0]) / 2
    every = np.arange(len(passed_over.voxels[0]))
    monkeypatch.setattr(Volume, "_reached", lambda *_: every)
    for found, expected in zip(passed_over.voxels, fused([one, some]).voxels, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_ground_seen_flat_has_no_holes():
    """A plane 0.5 m below, up to 3 m away, where rays meet it at 10°."""
    down = np.maximum(GRID.rays()[..., 1], 1e-3)
    volume = fused([view(np.zeros(3), np.minimum(0.5 / down, 9.0))])
    rays = GRID.rays()[(down > 0.5 / 3) & (down < 0.5)][None]
    inverse, _ = volume.march(osl.Pose.identity(), rays, REACH)
    assert np.isfinite(inverse).mean() > 0.99
    np.testing.assert_allclose(1 / inverse * rays[..., 1], 0.5, atol=VOXEL / 10)


def test_memory_is_what_the_arrays_take():
    keys = touched_blocks(view(np.zeros(3), np.full(GRID.shape, RADIUS)), GRID, VOXEL, REACH)
    arrays = Volume(keys, VOXEL, REACH, 1).voxels
    assert bytes_needed(keys, 1) >= sum(array.nbytes for array in arrays[1:] if array.ndim > 1)


def test_a_ray_keeps_its_own_depth_where_something_moves_near_the_rig_and_where_nothing_was_fused():
    shape, sphere = (60, 90), 1e-3
    own, fused_depth = np.full(shape, 1 / 20.0), np.full(shape, 1 / 22.0)
    seen, remembered = np.full(shape, 100.0), np.full((*shape, 1), 50.0)  # half as long exposed
    # a car, across the seam, before what was fused
    own[10:30, 80:], own[10:30, :10] = 1 / 12.0, 1 / 12.0
    seen[10:30, 80:], seen[10:30, :10] = 180.0, 180.0
    own[40:50, 20:40] = 1 / 12.0  # wrong: what was fused looks like this
    own[:5], fused_depth[:5] = 1 / 4.0, 1 / 4.2
    fused_depth[55:] = np.nan
    expected = fused_depth.copy()
    for rows, columns in (
        (slice(10, 30), slice(80, 90)),
        (slice(10, 30), slice(0, 10)),
        (slice(5), slice(90)),
        (slice(55, 60), slice(90)),
    ):
        expected[rows, columns] = own[rows, columns]
    moving = moving_rays(own, fused_depth, seen, remembered, sphere)
    np.testing.assert_allclose(mix(own, fused_depth, moving), expected, rtol=1e-6)


def test_a_trajectory_is_in_the_format_of_tum():
    poses = {3: osl.Pose.identity(), 8: T_A_B}
    row = np.array(trajectory_tum(poses).splitlines()[2].split(), float)
    assert row[0] == 8
    np.testing.assert_allclose(row[1:4], T_A_B.t, atol=1e-8)
    np.testing.assert_allclose(Rotation.from_quat(row[4:]).as_matrix(), T_A_B.R, atol=1e-8)
    times = {3: 0, 8: 1403636579763555584}  # a float would lose the last three digits
    assert trajectory_tum(poses, times).splitlines()[2].split()[0] == "1403636579.763555584"


def test_a_trajectory_is_read_as_it_was_written_and_a_damaged_one_refused(tmp_path):
    path = tmp_path / "trajectory.txt"
    path.write_text(trajectory_tum({3: osl.Pose.identity(), 8: T_A_B}))
    poses = read_trajectory(path)
    assert list(poses) == [3, 8]
    np.testing.assert_allclose(poses[8].as_vector(), T_A_B.as_vector(), atol=1e-8)
    for line in ("8 0 0 0 0 0 0", "8 0 0 0 0 0 0 2", "eight 0 0 0 0 0 0 1"):
        path.write_text(line)
        with refused(r"trajectory.txt has the line .* expected frame tx ty tz"):
            read_trajectory(path)


def test_features_lie_where_the_image_has_them_on_average():
    """OpenCV's default puts keypoints a quarter pixel right and down, which turns the path."""
    camera = scene.camera(width=400, height=384)
    rays, valid = camera.unproject(np.stack(np.meshgrid(np.arange(400), np.arange(384)), -1))
    spots = np.random.default_rng(0).normal((0, 0, 1), 1, (400, 3))
    spots /= np.linalg.norm(spots, axis=1, keepdims=True)
    nearest = np.max([rays @ spot for spot in spots], axis=0)
    image = np.where(valid, 40 + 160 * np.exp((nearest - 1) / np.radians(1.5) ** 2), 40).astype(
        np.uint8
    )
    found = FeatureFinder(camera).find(image).rays
    pixels, spot = camera.project(found)[0], spots[np.argmax(found @ spots.T, axis=1)]
    close = np.einsum("ki,ki->k", found, spot) > np.cos(np.radians(0.5))
    offset = np.median((pixels - camera.project(spot)[0])[close], axis=0)
    assert close.sum() > 50 and np.abs(offset).max() < 0.05


def test_frames_out_of_order_in_space_are_told():
    """As sorted by the last digits, of a drive of even steps; twice around is no fault."""
    order = [726, 727, 728, 729, 723, 730, 724, 725]
    poses = {k: osl.Pose(np.eye(3), np.array([1.4 * n, 0.0, 0.0])) for k, n in enumerate(order)}
    assert jumps_past_others(poses) == [4, 5, 6]
    angles = np.linspace(0, 4 * np.pi, 45)
    laps = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], 1)
    assert not jumps_past_others({k: osl.Pose(np.eye(3), t) for k, t in enumerate(laps)})
