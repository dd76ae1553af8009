#!/usr/bin/env bash
# Depth out of a ROS bag by rosbags-image: a compressed 16-bit PNG is 8 bits, an image whose rows are padded is sheared.
# Guessed before: millimetres as they were recorded, and rows found by the `step` that the message states.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" rosbags-image==0.10.4 rosbags==0.11.9 opencv-python-headless==5.0.0.93 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
from importlib.metadata import version
import cv2, numpy as np
from rosbags.image import ImageConversionError, message_to_cvimage
from rosbags.typesys import Stores, get_typestore
types = get_typestore(Stores.ROS2_JAZZY).types
head = types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](0, 0), frame_id="depth")
depth = 1000 * np.arange(1, 13, dtype=np.uint16).reshape(3, 4)  # millimetres
print("rosbags-image", version("rosbags-image"), "| recorded:", depth.tolist())

png = cv2.imencode(".png", depth)[1].ravel()
message = types["sensor_msgs/msg/CompressedImage"](header=head, format="16UC1; png compressed ", data=png)
small = message_to_cvimage(message)
print("CompressedImage, 16UC1 png:", small.dtype, small.tolist())
assert small.dtype == np.uint8 and np.array_equal(small, depth >> 8)
try:
    raise AssertionError(message_to_cvimage(message, "16UC1").tolist())
except ImageConversionError as error:
    print("asked for 16UC1:", error)

rows = np.pad(depth, ((0, 0), (0, 2)))  # each row aligned to 12 bytes
data = rows.view(np.uint8).ravel()
sheared = message_to_cvimage(types["sensor_msgs/msg/Image"](head, 3, 4, "16UC1", 0, 12, data))
print("Image, 4 wide, step of 12 bytes:", sheared.tolist())
assert np.array_equal(sheared, rows.ravel()[:12].reshape(3, 4))
data = depth.view(np.uint8).ravel()
assert np.array_equal(message_to_cvimage(types["sensor_msgs/msg/Image"](head, 3, 4, "16UC1", 0, 8, data)), depth)
PY
