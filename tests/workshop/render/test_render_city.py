"""The city without Blender: the drive, its streets, lots and traffic."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workshop.render.city.drive import ROUTES, plan_drive
from workshop.render.city.layout import HALF_STREET, LANE, STREETS, plan_district, split_lots
from workshop.render.city.traffic import Traffic
from workshop.render.city.vehicles import BODIES
from workshop.render.image_sets import SEED

DISTRICT = plan_district(SEED)


@pytest.mark.parametrize("route", ROUTES)
def test_drive_is_even_and_keeps_to_its_lane(route):
    drive = plan_drive(DISTRICT, route, 300)
    steps = np.diff(drive.points, axis=0)
    length = np.linalg.norm(steps, axis=1)
    assert length.max() / length.min() < 1.03  # chords of the turns are a little shorter
    along = np.stack([np.cos(drive.headings), np.sin(drive.headings)], -1)
    assert (np.sum(along[:-1] * steps, -1) / length > 0.95).all()
    crossing = 2 * HALF_STREET
    for point, heading in zip(drive.points, along, strict=True):
        axis = int(abs(heading[1]) > abs(heading[0]))  # 0: drives along x, so its lane is told by y
        if np.abs((DISTRICT.xs, DISTRICT.ys)[axis] - point[axis]).min() < crossing:
            continue
        lines = (DISTRICT.ys, DISTRICT.xs)[axis]
        center_line = lines[np.abs(lines - point[1 - axis]).argmin()]
        right = np.array([heading[1], -heading[0]])[1 - axis]
        assert (point[1 - axis] - center_line) * right == pytest.approx(LANE, abs=1e-6)


def test_train_and_test_share_neither_streets_nor_crossings():
    train, test = (plan_drive(DISTRICT, route, 300).points for route in ("train", "test"))
    assert np.linalg.norm(train[:, None] - test, axis=-1).min() > 2 * HALF_STREET


@pytest.mark.parametrize("route", ROUTES)
def test_poses_of_the_drive(route):
    drive = plan_drive(DISTRICT, route, 60)
    for index in range(60):
        pose = drive.pose(index)
        np.testing.assert_array_equal(pose.t, drive.pose(index).t)
        np.testing.assert_allclose(pose.R @ pose.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose.R) == pytest.approx(1)
        assert pose.R[2, 1] < -np.cos(np.radians(5))  # the rig's y points to the ground
        forward = np.array([np.cos(drive.headings[index]), np.sin(drive.headings[index]), 0])
        assert pose.R[:, 2] @ forward > np.cos(np.radians(5))
        np.testing.assert_array_equal(pose.t[:2], drive.points[index])
        assert 1.8 < pose.t[2] < 2.0


@given(st.integers(0, 2**32))
@settings(max_examples=20, deadline=None)
def test_lots_fill_their_block_and_do_not_overlap(seed):
    district = plan_district(seed)
    for block in district.blocks:
        area = block.building_line
        lots = split_lots(block, np.random.default_rng([seed, block.number]))
        assert not any(lot.empty for lot in lots if sum(lot.street_sides) > 1)
        assert sum(np.prod(lot.ground.size) for lot in lots) == pytest.approx(np.prod(area.size))
        for lot in lots:
            g = lot.ground
            assert area.x0 <= g.x0 + 1e-9 and g.x1 <= area.x1 + 1e-9
            assert area.y0 <= g.y0 + 1e-9 and g.y1 <= area.y1 + 1e-9
            assert all(
                opened or not street
                for opened, street in zip(lot.open_sides, lot.street_sides, strict=True)
            )
        for a, b in itertools.combinations((lot.ground for lot in lots), 2):
            assert (
                min(a.x1, b.x1) - max(a.x0, b.x0) < 1e-9 or min(a.y1, b.y1) - max(a.y0, b.y0) < 1e-9
            )


def test_blocks_leave_room_for_the_streets():
    kerbs = [block.kerb for block in DISTRICT.blocks]
    assert len(kerbs) == (STREETS + 1) ** 2
    for a, b in itertools.combinations(kerbs, 2):
        gap = max(max(a.x0, b.x0) - min(a.x1, b.x1), max(a.y0, b.y0) - min(a.y1, b.y1))
        assert gap >= 2 * HALF_STREET - 1e-9


@pytest.mark.parametrize("frame", [1, 706])
def test_traffic_neither_collides_nor_comes_near_the_rig(frame):
    cars = []

    def put(kind, at, yaw, paint):
        cars.append(SimpleNamespace(kind=kind))
        return cars[-1]

    traffic = Traffic(DISTRICT, SimpleNamespace(put=put))
    rig = plan_drive(DISTRICT, "test", 300).points[frame % 300]
    traffic.show(frame, rig)
    seen = [car for car in cars if not car.hide_render]
    assert len(seen) > 50
    at = np.array([car.location[:2] for car in seen])
    along_x = np.abs(np.cos([car.rotation_euler[2] for car in seen]))[:, None] > 0.5
    size = np.array([(BODIES[car.kind].length, BODIES[car.kind].width) for car in seen])
    half = np.where(along_x, size, size[:, ::-1]) / 2
    gap = (np.abs(at[:, None] - at) - half[:, None] - half).max(-1)
    assert gap[~np.eye(len(seen), dtype=bool)].min() > 0.1
    assert np.linalg.norm((np.abs(at - rig) - half).clip(0), axis=1).min() > 2.9
