"""Cycles behind plain functions: set up a scene, render a fisheye or a depth panorama."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import mathutils
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Pose
from workshop.render.camera.lens import SENSOR_MM, Lens

_SKY_DISTANCE = 1e9  # Cycles writes 1e10 where a ray meets nothing
# our camera (x right, y down, z forward) in Blender's (y up, −z forward)
_TO_BLENDER = np.diag([1.0, -1.0, -1.0])


def empty_scene() -> None:
    """Forget everything and prepare Cycles on the CPU with one panoramic camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.use_persistent_data = True  # keep the geometry between pictures
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.color_mode = "RGB"
    scene.view_settings.view_transform = "Raw"
    cycles = scene.cycles
    cycles.device, cycles.use_adaptive_sampling = "CPU", False
    cycles.max_bounces, cycles.diffuse_bounces = 3, 2
    cycles.glossy_bounces, cycles.transmission_bounces = 2, 0
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 6.0
    cycles.denoiser, cycles.denoising_input_passes = "OPENIMAGEDENOISE", "RGB_ALBEDO_NORMAL"
    cycles.denoising_prefilter, cycles.denoising_quality = "FAST", "HIGH"
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.sensor_width = "PANO", SENSOR_MM
    camera.data.clip_start, camera.data.clip_end = 0.01, 1e5
    scene.collection.objects.link(camera)
    scene.camera = camera


def fisheye_picture(
    lens: Lens, T_world_cam: Pose, size: tuple[int, int], samples: int, seed: int
) -> NDArray[np.float32]:
    """Render linear radiance, shape (height, width, 3), 0 outside the lens circle.

    Args:
        lens: Where each pixel looks.
        T_world_cam: The camera (x right, y down, z forward) in the world (z up).
        size: Width and height.
        samples: Paths for each pixel; what noise is left is taken away by Open Image Denoise.
        seed: Of the sampler: the same seed gives the same pixels on the same version and processor.
    """
    scene, camera = bpy.context.scene, bpy.context.scene.camera.data
    camera.panorama_type = "FISHEYE_LENS_POLYNOMIAL"
    camera.fisheye_fov = np.radians(lens.rendered_fov_deg)
    for k, value in enumerate(lens.blender_coefficients()):
        setattr(camera, f"fisheye_polynomial_k{k}", value)
    camera.shift_x, camera.shift_y = lens.blender_shift()
    scene.cycles.samples, scene.cycles.seed, scene.cycles.use_denoising = samples, seed, True
    scene.cycles.filter_width = 1.5
    scene.view_layers[0].use_pass_z = False
    scene.use_nodes = False
    return _render(T_world_cam, size)


def depth_panorama(T_world_rig: Pose, size: tuple[int, int], phi_deg: float) -> NDArray[np.float64]:
    """Render the distance along each ray from the rig's centre, shape (height, width), infinite in
    the sky.

    Columns run over θ from −180° to 180°, rows over φ from −phi_deg (up) to +phi_deg (down), at
    pixel centres.
    """
    scene, camera = bpy.context.scene, bpy.context.scene.camera.data
    camera.panorama_type = "EQUIRECTANGULAR"
    camera.longitude_min, camera.longitude_max = -np.pi, np.pi
    camera.latitude_min, camera.latitude_max = -np.radians(phi_deg), np.radians(phi_deg)
    camera.shift_x = camera.shift_y = 0.0
    scene.cycles.samples, scene.cycles.seed, scene.cycles.use_denoising = 1, 0, False
    # its table of offsets moves even the first sample a little off the middle
    scene.cycles.filter_width = 0.01
    scene.view_layers[0].use_pass_z = True
    _show_depth(scene)
    distance = _render(T_world_rig, size)[..., 0].astype(np.float64)
    return np.where(distance > _SKY_DISTANCE, np.inf, distance)


def _show_depth(scene: bpy.types.Scene) -> None:
    """Make the depth pass the picture."""
    scene.use_nodes = True
    if "depth" not in scene.node_tree.nodes:
        scene.node_tree.nodes.clear()
        layers = scene.node_tree.nodes.new("CompositorNodeRLayers")
        layers.name = "depth"
        output = scene.node_tree.nodes.new("CompositorNodeComposite")
        scene.node_tree.links.new(layers.outputs["Depth"], output.inputs["Image"])


def _render(T_world_cam: Pose, size: tuple[int, int]) -> NDArray[np.float32]:
    scene = bpy.context.scene
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = T_world_cam.R @ _TO_BLENDER, T_world_cam.t
    scene.camera.matrix_world = mathutils.Matrix(matrix.tolist())
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "picture.exr")
        with _silence():
            bpy.ops.render.render(write_still=True)
        return _read(scene.render.filepath, size)


def _read(path: str, size: tuple[int, int]) -> NDArray[np.float32]:
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(size[0] * size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    # Blender counts rows from the bottom
    return pixels.reshape(size[1], size[0], 4)[::-1, :, :3].copy()


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep Blender's chatter off standard output, which it writes to behind Python's back."""
    saved, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)
