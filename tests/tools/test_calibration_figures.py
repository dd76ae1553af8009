"""Where to hold the board next, against corners that leave known parts of a lens out."""

from types import SimpleNamespace

import numpy as np
import scene
from matplotlib.figure import Figure

from omnistereo_tools.output.calibration_figures import (
    direction_colors,
    draw_coverage,
    uncovered,
    verdict,
    where_next,
)

CAMERA = scene.camera(width=200, height=192)


def seen(keep):
    """A report on corners in all directions in view for which `keep` (angle, azimuth) holds."""
    theta, azimuth = np.meshgrid(np.radians(np.arange(2, 109, 2)), np.radians(np.arange(0, 360, 5)))
    pixels, valid = CAMERA.project(scene.polar_rays(theta, azimuth))
    chosen = valid & keep(np.degrees(theta), np.degrees(azimuth))
    report = SimpleNamespace(views_used=[0], corners={0: pixels[chosen]}, angles={0: theta[chosen]})
    report.max_corner_angle_deg = 109.0
    report.intrinsics = SimpleNamespace(image_size=(200, 192), camera=lambda _: CAMERA)
    report.rms_px, report.warnings = 0.07, ()
    return report


def test_nothing_is_asked_for_where_all_was_seen():
    report = seen(lambda angle, _: angle >= 0)
    assert uncovered(report, CAMERA) == [] and where_next(report, CAMERA) == ""
    assert verdict(report, CAMERA, "cam1") == [
        "Good: cam1, 0.07 px rms",
        "corners reach 109° from the axis; the lens is stated to 110°",
        "corners in all parts",
    ]


def test_a_wide_field_with_a_hole_in_the_centre_is_not_covered():
    report = seen(lambda angle, _: angle > 20)
    assert where_next(report, CAMERA) == "in the centre"
    first, _, todo = verdict(report, CAMERA, "cam1")
    assert first.startswith("Fair: cam1") and todo == "hold the board next where it is shaded"
    # a few corners at one end of it do not fill it
    few = seen(lambda angle, azimuth: (angle > 20) | ((angle > 15) & (azimuth < 15)))
    assert where_next(few, CAMERA) == "in the centre"


def test_the_parts_without_corners_are_named_and_drawn():
    # y points down: an azimuth of 90° is the bottom of the image
    report = seen(lambda angle, azimuth: (angle < 60) | (np.abs(azimuth - 90) > 30))
    assert where_next(report, CAMERA) == "near the rim: bottom"
    ax = Figure().subplots()
    draw_coverage(ax, report, CAMERA)
    (part,) = ax.patches
    assert (part.get_xy()[:, 1] > CAMERA.center[1] + 40).all()
    report = seen(lambda angle, _: angle < 30)
    assert where_next(report, CAMERA) == "halfway out: all around; near the rim: all around"


def test_directions_differ_in_colour_and_not_in_lightness():
    """By the luminance of sRGB, which IEC 61966-2-1 states."""
    colors = direction_colors(np.linspace(0, 2 * np.pi, 73))
    assert np.allclose(colors[0], colors[-1], atol=1e-3) and colors.min() > 0 and colors.max() < 1
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    assert luminance.max() - luminance.min() < 0.01
    steps = np.linalg.norm(np.diff(colors, axis=0), axis=1)
    assert steps.max() < 3 * steps.min()
