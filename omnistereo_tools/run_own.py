"""The process in which a method of one's own runs: `own_method` starts it, with a file and a
folder.

It imports nothing but NumPy and the file, so that the file stands on its own.
"""

import contextlib
import importlib.util
import json
import sys
import time
import traceback
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np


def main(file: str, folder: str) -> None:
    """Call the file's `depth` on the inputs in the folder; write there what it answers."""
    out = Path(folder)
    try:
        function = vars(load(Path(file).resolve())).get("depth")
        if not callable(function):
            said: dict[str, Any] = {"missing": True}
        else:
            started = time.process_time(), time.monotonic()
            found = function(*inputs(out))
            took = {
                "cpu_s": time.process_time() - started[0],
                "seconds": time.monotonic() - started[1],
            }
            said = took | stored(found, out)
    except BaseException as error:  # SystemExit as well
        said = {"error": described(error, Path(file).resolve())}
    (out / "said.json").write_text(json.dumps(said), encoding="utf-8")


def load(file: Path) -> ModuleType:
    """Import a file, which may import others beside it."""
    sys.path.append(str(file.parent))
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module
    spec.loader.exec_module(module)
    return module


def inputs(folder: Path) -> tuple[list[Any], list[SimpleNamespace], SimpleNamespace]:
    """Return images, cameras and grid, as `own_method.run_own` has written them."""
    told = json.loads((folder / "told.json").read_text(encoding="utf-8"))
    with np.load(folder / "images.npz", allow_pickle=False) as arrays:
        images = [arrays[f"image{k}"] for k in range(len(told["cameras"]))]
        masks = [arrays[f"valid{k}"] for k in range(len(told["cameras"]))]
    cameras = [
        SimpleNamespace(
            **facts | {name: np.array(facts[name]) for name in ("inv_poly", "poly", "R", "t")},
            valid=mask,
        )
        for facts, mask in zip(told["cameras"], masks, strict=True)
    ]
    return images, cameras, SimpleNamespace(**told["grid"])


def stored(found: Any, folder: Path) -> dict[str, Any]:
    """Write what `depth` has returned as arrays, if it is made of numbers; return what came."""
    parts = found if isinstance(found, tuple) else (found,)
    for name, part in zip(("index", "confidence"), parts, strict=False):
        array = (
            np.ma.filled(np.ma.asarray(part, float), np.nan)
            if np.ma.isMaskedArray(part)
            else np.asarray(part)
        )
        if array.dtype.kind not in "iuf":
            of = f"dtype {array.dtype}" if array.ndim else type(part).__name__
            return {"kind": f"{name} of {of}"}
        np.save(folder / f"{name}.npy", array.astype(np.float64))
    return {"parts": len(parts)}


def described(error: BaseException, file: Path) -> str:
    """Return what was raised, and the last line of the file on the way there."""
    frames = [
        frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)
    ]
    if isinstance(error, SyntaxError):
        return f"{type(error).__name__} in line {error.lineno}: {error.msg}"
    text = ""
    with contextlib.suppress(Exception):
        text = str(error)[:300]
    where = f", in line {frames[-1].lineno}: {frames[-1].line}" if frames else ""
    return f"{type(error).__name__}: {text}{where}"


if __name__ == "__main__":
    main(*sys.argv[1:])
