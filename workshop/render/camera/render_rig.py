"""Rigs: each camera a little different, all recorded exactly. Only NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.files import write_text
from omnistereo_lib.geometry.pose import Pose
from workshop.render.camera.lens import Lens, fit_ocam, random_fisheye, random_lens

# about y, which points down: front, right, back, left
_HEADINGS = (0.0, np.pi / 2, np.pi, -np.pi / 2)


@dataclass(frozen=True)
class Sensor:
    """How radiance becomes pixel values."""

    gain: float  # exposure relative to the other cameras
    read_noise: float  # standard deviation in the dark; white is 1
    shot_noise: float  # variance for each unit of signal
    falloff: float  # share of light lost at the rim of the picture


@dataclass(frozen=True)
class RigCamera:
    """One camera of a rig."""

    lens: Lens
    T_rig_cam: Pose
    sensor: Sensor


@dataclass(frozen=True)
class RenderRig:
    """Cameras and the smallest distance in metres that they are made for."""

    name: str
    cameras: tuple[RigCamera, ...]
    min_depth: float


# metres from the rig's centre; minimum depth
_RIGS = {"van": (0.60, 1.65), "handheld": (0.15 * np.sqrt(2), 0.55)}


def make_rig(seed: int, name: str = "van") -> RenderRig:
    """Return a rig: "van" (0.60 m from the centre, as in the public sets) or "handheld" (300 mm
    square).

    Cameras look forward, right, back and left, each turned by about half a degree and moved by
    millimetres at random. The displacements add up to zero, so the mean of the camera centres stays
    the rig's centre.
    """
    radius, min_depth = _RIGS[name]
    rng = np.random.default_rng([seed, 20, len(name)])
    moved = rng.normal(0, 0.01 * radius, (4, 3))
    moved -= moved.mean(axis=0)
    cameras = []
    for heading, offset in zip(_HEADINGS, moved, strict=True):
        ideal = Pose.from_vector(
            [0, heading, 0, radius * np.sin(heading), 0, radius * np.cos(heading)]
        )
        turned = Pose.from_vector([*rng.normal(0, np.radians(0.5), 3), 0, 0, 0])
        pose = ideal @ turned
        sensor = Sensor(
            float(rng.uniform(0.92, 1.08)),
            float(rng.uniform(0.003, 0.006)),
            float(rng.uniform(3e-5, 8e-5)),
            float(rng.uniform(0.08, 0.16)),
        )
        cameras.append(RigCamera(random_lens(rng), Pose(pose.R, ideal.t + offset), sensor))
    return RenderRig(name, tuple(cameras), min_depth)


def random_rig(rng: np.random.Generator, min_depth: float) -> RenderRig:
    """Draw a rig of 3 to 6 cameras on a circle that looks all around; none is like another.

    The radius is 1/8 to 1/2 of `min_depth`, and adjacent cameras are 0.05 to 1.5 m apart. Fields of
    view are 180° to 220°, from 200° for 3 cameras. Headings differ from equal steps by some
    degrees; every third rig has cameras above and below its plane. The mean of the camera centres
    is the centre of the rig.

    Args:
        min_depth: Distance in metres from the rig centre that nothing comes nearer than.
    """
    count = int(rng.integers(3, 7))
    share = np.exp(rng.uniform(np.log(1 / 8), np.log(1 / 2)))
    baseline = min_depth * share * 2 * np.sin(np.pi / count)
    radius = np.clip(baseline, 0.055, 1.2) / (2 * np.sin(np.pi / count))
    fov_deg = rng.uniform(200 if count == 3 else 182, 218)
    lift = radius * rng.uniform(0.1, 0.5) * (rng.random() < 1 / 3)
    headings = 2 * np.pi * np.arange(count) / count + rng.normal(0, np.radians(4), count)
    centers = radius * np.column_stack([np.sin(headings), np.zeros(count), np.cos(headings)])
    centers += rng.normal(0, 0.03 * radius, (count, 3))
    centers[:, 1] += lift * rng.uniform(-1, 1, count)
    centers -= centers.mean(axis=0)
    cameras = []
    for heading, center in zip(headings, centers, strict=True):
        tilted = Pose.from_vector([*rng.normal(0, np.radians((3, 2, 4))), 0, 0, 0])
        R = (Pose.from_vector([0, heading, 0, 0, 0, 0]) @ tilted).R
        lens = random_fisheye(rng, round(fov_deg + rng.uniform(-2, 2), 2))
        cameras.append(RigCamera(lens, Pose(R, center), _random_sensor(rng)))
    return RenderRig("random", tuple(cameras), min_depth)


def _random_sensor(rng: np.random.Generator) -> Sensor:
    return Sensor(
        float(np.exp(rng.normal(0, 0.12))),
        float(rng.uniform(0.002, 0.006)),
        float(rng.uniform(2e-5, 1e-4)),
        float(rng.uniform(0.05, 0.3)),
    )


def write_config(
    path: Path, rig: RenderRig, size: tuple[int, int], dataset: dict[str, object], digits: int = 8
) -> None:
    """Write a rig as `config.yaml` in the OmniMVS dialect, with what only a rendered rig knows
    added.

    Args:
        path: File to write.
        rig: The cameras; poses are camera → rig, metres.
        size: Width and height of the images.
        dataset: What goes under `dataset:`, plain numbers and strings.
        digits: Of the polynomials. Least squares differs between machines from the eleventh on, the
            file should not; 8 are 2e-6 px for the lenses of `random_lens`, up to a pixel for the
            high degrees of `random_fisheye`, 12 are 1e-3 px.
    """
    lines = ["config:", f"  omnimvs_sweep_min_depth: {rig.min_depth}", "dataset:"]
    lines += [
        f"  {key}: {value if isinstance(value, int | float) else _quoted(value)}"
        for key, value in dataset.items()
    ]
    lines.append("cameras:")
    for number, camera in enumerate(rig.cameras, start=1):
        lines += _camera_lines(number, camera, size, digits)
    write_text(path, "\n".join(lines) + "\n")


def _camera_lines(number: int, camera: RigCamera, size: tuple[int, int], digits: int) -> list[str]:
    fit, (width, height) = fit_ocam(camera.lens, size[0]), size
    entries = {
        "img_dir": f"cam{number}",
        "model": "ocam",
        "poly": _numbers([len(fit.poly), *_with_digits(fit.poly, digits)]),
        "inv_poly": _numbers([len(fit.inv_poly), *_with_digits(fit.inv_poly, digits)]),
        "center": _numbers([fit.center[1], fit.center[0]]),
        "affine": "[1.0, 0.0, 0.0]",
        "image_size": f"[{height}, {width}]",
        "pose": _numbers(
            [*_with_digits(camera.T_rig_cam.as_vector()[:3], 12), *camera.T_rig_cam.t]
        ),
        "max_fov": camera.lens.max_fov_deg,
        "fit_residual_px": float(f"{max(fit.residual_px, fit.inverse_residual_px):.2g}"),
        "exposure_gain": round(camera.sensor.gain, 6),
        "read_noise": round(camera.sensor.read_noise, 6),
        "shot_noise": round(camera.sensor.shot_noise, 9),
        "falloff": round(camera.sensor.falloff, 6),
    }
    return [f"- cam_id: {number}", *(f"  {key}: {value}" for key, value in entries.items())]


def _with_digits(values: NDArray, digits: int) -> list[float]:
    return [float(f"{value:.{digits}g}") for value in values]


def _numbers(values: NDArray | list) -> str:
    texts = (str(v) if isinstance(v, int) else _yaml_float(float(v)) for v in values)
    return f"[{', '.join(texts)}]"


def _yaml_float(value: float) -> str:
    # YAML reads "1e-05" as text: a float needs its point.
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _quoted(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)
