"""Masks of the cameras: which pixels are not the housing, the car or the rim of the lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_gray
from omnistereo_lib.geometry.rig import Rig

NAME = "mask.png"  # beside the images of a camera


def with_masks(rig: Rig, masks: Sequence[Path] | None, images: Sequence[Path]) -> Rig:
    """Return the rig with masks from files: bright where the image is valid.

    Args:
        masks: One file per camera. None: mask.png in the folder of the images of a camera, where there is one, each
            camera has a folder of its own, and the rig file has no mask of that camera.
        images: One path per camera; its folder is where mask.png is looked for.

    Raises:
        OmnistereoError: If there is not one mask per camera, or one cannot be read, has another size or hides all.
    """
    if masks is not None and len(masks) != len(rig):
        raise OmnistereoError(f"there are {len(masks)} masks for {len(rig)} cameras. Give one per camera.")
    folders = [path if path.is_dir() else path.parent for path in images]
    if masks is None and (len(set(folders)) < len(rig) or len(folders) != len(rig)):
        return rig
    cameras = []
    for k, camera in enumerate(rig.cameras):
        path = masks[k] if masks is not None else folders[k] / NAME
        if masks is not None or (camera.mask is None and path.is_file()):
            camera = replace(camera, mask=read_gray(path, camera.image_size) >= 128)
            if not camera.visible_pixels().any():
                raise OmnistereoError(f"{path} hides the whole picture; expected bright where it is valid. Invert it.")
        cameras.append(camera)
    return replace(rig, cameras=tuple(cameras))
