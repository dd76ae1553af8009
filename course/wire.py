"""Call a function in another process: arguments and result travel as JSON, in a file each way.

Nothing that comes back can run code here: it is numbers, text, arrays, lists, tuples, poses and cameras. Of anything
else the name of its type arrives.
"""

import base64
import io
import json
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose

CALL, REPLY = "call.json", "reply.json"
FIELDS = {
    Pose: ("R", "t"),
    OcamCamera: ("poly", "inv_poly", "center", "affine", "image_size", "max_fov_deg", "mask"),
}
CLASSES = {kind.__name__: kind for kind in FIELDS}


def encode(value: Any) -> Any:
    """Return a value as what JSON can hold; see `decode`."""
    if value is None or type(value) in (bool, int, float, str):
        return value
    if value is ...:
        return {"kind": "ellipsis"}
    if type(value) in (list, tuple):
        return {"kind": type(value).__name__, "items": [encode(item) for item in value]}
    if type(value) in FIELDS:
        fields = {name: encode(getattr(value, name)) for name in FIELDS[type(value)]}
        return {"kind": "object", "name": type(value).__name__, "fields": fields}
    if isinstance(value, np.ndarray | np.generic) or type(value).__name__ == "Tensor":
        content = io.BytesIO()
        np.save(content, np.asarray(value), allow_pickle=False)
        return {"kind": "array", "npy": base64.b64encode(content.getvalue()).decode()}
    raise TypeError(type(value).__name__)


def encode_result(value: Any) -> Any:
    """Return a value encoded, or the name of its type where it is none of those that travel."""
    try:
        return encode(value)
    except Exception:  # an object array, a tensor with a gradient, a list in itself, an object of the student's
        return {"kind": "other", "name": type(value).__name__}


def decode(encoded: Any) -> Any:
    """Return the value that was encoded; anything but the known kinds is a ValueError."""
    if not isinstance(encoded, dict):
        return encoded
    match encoded:
        case {"kind": "ellipsis"}:
            return ...
        case {"kind": "list", "items": items}:
            return [decode(item) for item in items]
        case {"kind": "tuple", "items": items}:
            return tuple(decode(item) for item in items)
        case {"kind": "object", "name": name, "fields": fields} if name in CLASSES:
            return CLASSES[name](**{field: decode(value) for field, value in fields.items()})
        case {"kind": "array", "npy": npy}:
            return np.load(io.BytesIO(base64.b64decode(npy)), allow_pickle=False)[()]
        case {"kind": "other", "name": str(name)}:
            return type(name, (), {})()
    raise ValueError(f"no value is encoded as {str(encoded)[:80]}")


def write_call(folder: Path, arguments: tuple) -> None:
    """Write the arguments of a call into its folder, where no reply is left from another one."""
    (folder / REPLY).unlink(missing_ok=True)
    (folder / CALL).write_text(json.dumps([encode(argument) for argument in arguments]), encoding="utf-8")


def serve(function: Callable, folder: str) -> None:
    """Answer a call in the student's process: write what the function returns, or how it stopped.

    Arrays among the arguments are sent back, since the function may have written into them.
    """
    arguments = [decode(argument) for argument in json.loads(Path(folder, CALL).read_text(encoding="utf-8"))]
    try:
        reply = {"value": encode_result(function(*arguments))}
    except (Exception, SystemExit) as error:
        kind, _, text = "".join(traceback.format_exception_only(error)).strip().partition(": ")
        reply = {"error": kind, "text": text}
    reply["arguments"] = [encode_result(argument) for argument in arguments]
    Path(folder, REPLY).write_text(json.dumps(reply), encoding="utf-8")


def read_reply(folder: Path, arguments: tuple) -> Any:
    """Return what the function returned, after writing into the arguments what it wrote; raise what it raised."""
    reply = json.loads((folder / REPLY).read_text(encoding="utf-8"))
    for argument, sent in zip(arguments, reply["arguments"], strict=True):
        if isinstance(argument, np.ndarray):
            argument[...] = decode(sent)
    if "error" in reply:  # with its name, but as an exception of no other use
        raise type(reply["error"].rpartition(".")[2], (Exception,), {"__module__": "builtins"})(reply["text"])
    return decode(reply["value"])
