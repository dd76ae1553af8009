"""Depth without torch: run the exported VolumeNet by ONNX Runtime. Needs numpy, onnxruntime and
opencv-python.

`omnistereo onnx` copies this file beside depth.onnx, which is made for one rig and one panorama.
example: python run_onnx.py front.png right.png back.png left.png --out inverse_depth.npy
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import onnxruntime as ort


def read_images(paths: list[str], inputs: list[ort.NodeArg]) -> dict[str, np.ndarray]:
    """Return the images by the names of the inputs, (h, w, 3) RGB; exit if they do not fit."""
    if len(paths) != len(inputs):
        raise SystemExit(
            f"error: there are {len(paths)} images for {len(inputs)} cameras. Give one for each."
        )
    images = {}
    for path, wanted in zip(paths, inputs, strict=True):
        image = cv2.imread(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None:
            raise SystemExit(f"error: {path} cannot be read as an image. Check the path.")
        if list(image.shape) != wanted.shape:
            (height, width, _), (h, w, _) = image.shape, wanted.shape
            found = f"{width} × {height} px; the camera has {w} × {h} px"
            raise SystemExit(f"error: {path} is {found}. Pass images as they were calibrated.")
        images[wanted.name] = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return images


def main() -> None:
    """Compute the depth of one frame."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("images", nargs="+", help="one image per camera, in the order of the rig")
    parser.add_argument(
        "--out", default="inverse_depth.npy", help="float32, 1/m, 0 = infinitely far, NaN = unknown"
    )
    options = parser.parse_args()
    # Folded, the coordinates of all cells would be constants: four times the memory.
    session = ort.InferenceSession(
        Path(__file__).with_name("depth.onnx"), disabled_optimizers=["ConstantFolding"]
    )
    inverse_depth, _confidence = session.run(
        None, read_images(options.images, session.get_inputs())
    )
    np.save(options.out, inverse_depth)
    height, width = inverse_depth.shape
    print(
        f"{options.out}: {width} × {height} rays, the nearest at"
        f" {1 / np.nanmax(inverse_depth):.2g} m"
    )


if __name__ == "__main__":
    main()
