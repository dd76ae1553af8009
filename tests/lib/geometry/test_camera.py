"""The polynomial camera against camera models in closed form."""

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from scene import polar_rays, refused

from omnistereo_lib import OcamCamera
from omnistereo_lib.geometry.camera import fit_inverse_polynomial

SIZE = (800, 760)  # width, height
CENTER = (402.3, 377.6)
AFFINE = (1.002, -0.003, 0.004)  # c, d, e
F = 140.0  # px: the circle of 220° is a little larger than the image


def stereographic(f=F, **changes):
    """r = 2 f tan(θ/2): the direct polynomial is exactly -f + r²/(4f); the inverse is a fit."""
    poly = [-f, 0.0, 1 / (4 * f)]
    parameters = {
        "poly": poly,
        "inv_poly": fit_inverse_polynomial(poly, 220.0, 3 * max(SIZE), tolerance=2e-8),
        "center": CENTER,
        "affine": AFFINE,
        "image_size": SIZE,
    }
    return OcamCamera(**parameters | changes)


def equidistant(f=180.0, **changes):
    """r = f θ: the inverse polynomial is exactly f (t + π/2)."""
    parameters = {"poly": [-f, 0.0, 1e-3], "inv_poly": [f * np.pi / 2, f]}
    parameters |= {"center": CENTER, "affine": AFFINE}
    return OcamCamera(**parameters | {"image_size": SIZE} | changes)


def pixel(radius, azimuth):
    """The affine map by hand, in rows and columns as the files' documentation writes it."""
    c, d, e = AFFINE
    row, column = radius * np.sin(azimuth), radius * np.cos(azimuth)
    return np.stack([e * row + column + CENTER[0], c * row + d * column + CENTER[1]], -1)


THETA = np.radians(np.arange(0, 110.5, 0.5))[:, None]
AZIMUTH = np.radians(np.arange(0, 360, 7.0))


def test_every_angle_lands_where_the_closed_form_says():
    uv, _ = equidistant().project(polar_rays(THETA, AZIMUTH))
    np.testing.assert_allclose(uv, pixel(180.0 * THETA, AZIMUTH), atol=1e-9)
    for direct, tolerance in ((True, 1e-9), (False, 1e-7)):
        uv, _ = stereographic().project(polar_rays(THETA, AZIMUTH), direct)
        np.testing.assert_allclose(uv, pixel(2 * F * np.tan(THETA / 2), AZIMUTH), atol=tolerance)


@pytest.mark.parametrize("direct", [False, True])
def test_round_trip_from_rays_and_from_pixels(direct):
    camera = stereographic()
    rays = polar_rays(THETA, AZIMUTH)
    uv, valid = camera.project(rays, direct)
    back, valid_back = camera.unproject(uv, direct)
    assert (valid_back == valid).all() and 0.7 < valid.mean() < 1  # the image cuts off the circle
    np.testing.assert_allclose(back[valid], rays[valid], atol=1e-9)
    grid = np.stack(np.meshgrid(np.arange(0, SIZE[0], 7.0), np.arange(0, SIZE[1], 7.0)), -1)
    rays, valid = camera.unproject(grid, direct)
    again, valid_again = camera.project(rays, direct)
    assert valid.any() and valid_again[valid].all()
    assert np.abs(again - grid)[valid].max() < 1e-6
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=1e-12)


WIDE = stereographic(image_size=(2400, 2400), center=(1200.0, 1200.0))


@given(
    st.floats(0, np.radians(109.9)), st.floats(-np.pi, np.pi), st.floats(1e-3, 1e6), st.booleans()
)
@example(5e-324, 0.0, 1.0, False)  # off the axis by the smallest float
def test_round_trip_of_any_point(theta, azimuth, distance, direct):
    uv, valid = WIDE.project(distance * polar_rays(theta, np.float64(azimuth)), direct)
    assert valid
    np.testing.assert_allclose(
        WIDE.unproject(uv, direct)[0], polar_rays(theta, np.float64(azimuth)), atol=1e-9
    )


@pytest.mark.parametrize("direct", [False, True])
def test_torch_agrees_with_numpy(direct):
    rng = np.random.default_rng(0)
    camera = stereographic(mask=rng.random(SIZE[::-1]) > 0.3)
    points = rng.normal(size=(40, 50, 3))
    points[0, :5] = [[0, 0, 0], [0, 0, 2], [np.nan, 0, 1], [np.inf, 1, 1], [0, 0, -1]]
    uv, valid = camera.project(points, direct)
    uv_torch, valid_torch = camera.project(torch.tensor(points), direct)
    assert (valid_torch.numpy() == valid).all() and 0.2 < valid.mean() < 0.9
    np.testing.assert_allclose(uv_torch.numpy(), uv, atol=1e-10)
    single, _ = camera.project(torch.tensor(points, dtype=torch.float32), direct)
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single.numpy(), uv, atol=2e-3)


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.float64])
def test_validity_comes_from_geometry_and_mask(dtype):
    """A mask may have any type: non-zero is valid."""
    mask = np.full(SIZE[::-1], 0.25 if dtype is np.float64 else 1, dtype)
    mask[:, 500:] = 0
    camera = equidistant(mask=mask)
    points = polar_rays(np.radians([0, 20, 60, 109, 111, 180]), np.array(0.0))
    assert camera.project(points)[1].tolist() == [True, True, False, False, False, False]
    assert equidistant().project(points)[1].tolist() == [True, True, True, True, False, False]
    uv = [[-0.6, 300], [0, 377], [402, 377], [499, 377], [501, 377], [400, 760], [np.nan, 1]]
    assert camera.unproject(uv)[1].tolist() == [False, False, True, True, False, False, False]
    assert equidistant(image_size=(4000, 4000)).unproject([[3999, 377], [402, 377]])[
        1
    ].tolist() == [False, True]


def test_visible_pixels_are_those_that_unproject_accepts():
    mask = np.random.default_rng(0).random(SIZE[::-1]) < 0.9
    masked = stereographic(f=90.0, affine=(1.02, 0.01, -0.02), mask=mask)
    pixels = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), -1)
    for camera in (stereographic(f=90.0), masked, masked.reduced(3)):
        width, height = camera.image_size
        expected = camera.unproject(pixels[:height, :width])[1]
        np.testing.assert_array_equal(camera.visible_pixels(), expected)
        assert 0 < expected.mean() < 1


def test_sees_is_what_project_calls_valid():
    """Where the whole field of view is in the image, first and last, and where it is not."""
    points = np.random.default_rng(1).normal(size=(20_000, 3))
    points[:4] = [[0, 0, 0], [np.nan, 0, 1], [0, np.inf, 0], [0, 0, -1]]
    mask = np.random.default_rng(0).random(SIZE[::-1]) < 0.9
    whole = [stereographic(f=90.0), stereographic(f=90.0, mask=mask)]
    whole += [stereographic(), equidistant()]
    assert [camera._whole_view for camera in whole] == [True, False, False, True]
    for camera in whole:
        np.testing.assert_array_equal(camera.sees(points), camera.project(points)[1])


def test_useless_points_are_invalid_and_finite():
    uv, valid = equidistant().project([[0, 0, 0], [np.nan, 0, 1], [0, np.inf, 0], [0, 0, -np.inf]])
    assert not valid.any() and np.isfinite(uv).all()


@pytest.mark.parametrize("fov", [60.0, 220.0, 250.0])
def test_inverse_polynomial_is_as_good_as_promised(fov):
    f, theta = F, np.radians(np.linspace(0, fov / 2, 500))
    inverse = np.polynomial.Polynomial(fit_inverse_polynomial([-f, 0, 1 / (4 * f)], fov, 4000))
    assert np.abs(inverse(theta - np.pi / 2) - 2 * f * np.tan(theta / 2)).max() < 0.011


def test_inverse_poly_error_is_the_closed_form_distance():
    camera = stereographic()
    assert camera.inverse_poly_error_px() < 1e-6
    scaled = stereographic(inv_poly=camera.inv_poly * 1.01)
    assert scaled.inverse_poly_error_px() == pytest.approx(
        0.01 * 2 * F * np.tan(np.radians(55)), rel=1e-4
    )


def test_bad_points_and_polynomials_are_named():
    with refused(r"shape \(4, 2\); expected \(..., 3\)"):
        equidistant().project(np.zeros((4, 2)))
    with refused(r"shape \(3,\); expected \(..., 2\)"):
        equidistant().unproject(torch.zeros(3))
    with refused(r"monotonic only .*Lower max_fov_deg"):
        fit_inverse_polynomial([-180.0, 0.0, -1e-3], 220, 2000)
    with refused(r"poly starts with 180\.0; expected a0 < 0"):
        fit_inverse_polynomial([180.0, 0.0, 1e-3], 220, 2000)
    with refused(r"degree 25 has an error of .*expected at most 1e-06 px"):
        fit_inverse_polynomial([-F, 0, 1 / (4 * F)], 350, 20000, tolerance=1e-6)
    with refused(r"inv_poly starts at 4.72e\+03 px; expected 0 on the"):
        equidistant(inv_poly=[5000.0, 180.0])


def test_the_direct_polynomial_ends_where_it_stops_growing():
    """f(r)/r = -100/r - 6.25e-6 r² grows up to r = 200 px; beyond 286 px angles come again."""
    poly = [-100.0, 0.0, 0.0, -6.25e-6]
    camera = OcamCamera(
        poly, fit_inverse_polynomial(poly, 100, 250), (349.5, 349.5), (1, 0, 0), (700, 700), 100
    )
    valid = camera.unproject(
        [[349.5 + r, 349.5] for r in (100, 130, 220, 300, 340)], use_direct_poly=True
    )[1]
    np.testing.assert_array_equal(valid, [True, True, False, False, False])
    # does not limit the direct polynomial
    other = stereographic(inv_poly=0.9 * stereographic().inv_poly)
    uv, valid = other.project(polar_rays(THETA, AZIMUTH), True)
    assert (other.unproject(uv, True)[1] == valid).all()
