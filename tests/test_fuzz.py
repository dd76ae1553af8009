"""Damaged files, thousands of them: every reader answers with the library's error, or returns what
is finite.

FUZZ=20000 python -m pytest tests/test_fuzz.py takes so many for each reader. The seed of a file is
its number: the name of the reader and the number in a message bring it back."""

import json
import os
import random
import re
import socket
import struct
import warnings
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest
import scene
import torch
import yaml
from learn.tiny import MCCNN as RECIPE
from PIL import Image
from rigs.formats.rig_file_samples import EXAMPLES, OCAM_TXT, POSES_TXT, RAYS, omnimvs

import omnistereo_lib as osl
from course.classroom import handin
from omnistereo_learn.evaluate.records import read_record
from omnistereo_learn.evaluate.table import errors_table, regions_table
from omnistereo_learn.loop import COLUMNS, _Run, read_log, write_csv
from omnistereo_lib.pictures import read_image
from omnistereo_rigs.boards.captures import load_corners, save_corners
from omnistereo_rigs.boards.checkerboard import Checkerboard
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig
from omnistereo_tools.live_view import Latest, LivePicture, serve

MEMORY = 1 << 30
pytestmark = pytest.mark.nightly
FILES = int(os.environ.get("FUZZ", "50"))
NUMBERS = [0, -1, 1e308, -1e308, 1e30, float("nan"), float("inf"), 2.5]
WORDS = [*map(str, NUMBERS), ".nan", "-.inf", "abc", "[]", "{}", "null", "true", "*a", "&a", '"']
WORDS += ["³", "\ufeff", "!!python/name:os", "2020-99-99", "", "9" * 400, "\t", "a: b"]
VALUES = [*NUMBERS, None, True, 10**30, "", "abc", [], {}, [[]], [1], {"a": 1}, [[[[1]]]]]
VALUES += ["../x", "/dev/zero", "I32"]


def damage(content, rng):
    """Change the content of a file at random: values of JSON, words, lines or bytes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        ways = _change_value, _change_word, _change_word, _change_line, _change_bytes
        content = rng.choice(ways)(content, rng)
    return content


def _change_value(content, rng):
    try:
        values = json.loads(content)
    except (ValueError, RecursionError):
        return _change_word(content, rng)
    at, key = values, None
    while isinstance(at, dict | list) and at and (key is None or rng.random() < 0.8):
        parent, key = at, rng.choice(list(at) if isinstance(at, dict) else range(len(at)))
        at = at[key]
    if key is None:
        return content
    action = rng.randrange(4)
    if action == 0:
        del parent[key]
    else:
        parent[key] = rng.choice(VALUES) if action < 3 else [at] * rng.choice((1, 2, 50))
    return json.dumps(values).encode()


def _change_word(content, rng):
    words = list(re.finditer(rb"[^\s,\[\]{}:]+", content))
    if not words:
        return content
    start, end = rng.choice(words).span()
    return content[:start] + rng.choice(WORDS).encode() + content[end:]


def _change_line(content, rng):
    lines = content.split(b"\n")
    k = rng.randrange(len(lines))
    lines[k : k + 1] = rng.choice(([], [lines[k]] * 2, [b"  " + lines[k]], [rng.choice(lines)]))
    return b"\n".join(lines)


def _change_bytes(content, rng):
    at, length = rng.randrange(len(content) + 1), rng.choice((1, 1, 4, 40))
    kind = rng.randrange(4)
    if kind == 0:
        return content[:at]
    if kind == 1:
        return content[:at] + rng.randbytes(length) + content[at + length :]
    if kind == 2:
        return content[:at] + content[at + length :]
    return content[:at] + content[at : at + length] * 2 + content[at + length :]


def damage_tensors(content, rng):
    """As `damage`, but mostly of the header, whose length is then right."""
    (length,) = struct.unpack("<Q", content[:8])
    if rng.random() < 0.2:
        return _change_bytes(content, rng)
    header = json.loads(content[8 : 8 + length])
    if rng.random() < 0.5:
        about = header["__metadata__"]["about"].encode()
        header["__metadata__"]["about"] = _change_value(about, rng).decode(errors="replace")
        header = json.dumps(header).encode()
    else:
        header = _change_value(json.dumps(header).encode(), rng)
    return struct.pack("<Q", len(header)) + header + content[8 + length :]


# ---- what is read must be finite


def check_rig(rig):
    for camera in rig.cameras:
        check_camera(camera)
    assert np.isfinite(rig.baselines).all()


def check_camera(camera):
    uv, _ = camera.project(RAYS)
    assert np.isfinite(uv).all() and np.isfinite(camera.unproject(uv)[0]).all()


def check_corners(read):
    views, board, (width, height) = read
    assert len(board.points) and 2 <= width <= 100_000 and 2 <= height <= 100_000
    assert all(view is None or not np.isinf(view).any() for view in views.values())


def check_image(image):
    assert np.isfinite(image).all()
    assert image.shape[:2] != (0, 0)
    assert 0 <= image.min() <= image.max() <= 255


def check_network(network):
    assert all(
        tensor.isfinite().all() and tensor.dtype == torch.float32 for tensor in network.parameters()
    )


def check_results(results):
    assert errors_table(results).text() and regions_table(results).text()


def check_log(rows):
    assert [row["step"] for row in rows] == list(range(len(rows)))


def check_cells(cells):
    assert all(isinstance(source, str) for _, source in cells)


def check_answer(answer):
    status, body = answer
    assert status in (200, 400, 403, 404, 405, 408, 414, 431, 501, 505) or status is None
    assert (
        status != 200
        or body in (b"", b"no depth here", b"2.00 m along the ray")
        or b"<!doctype html>" in body
    )


def check_step(step):
    assert isinstance(step, int) and step >= 0


# ---- valid files, and how each is read


def samples(folder):
    """Return reader → (file name, content, how it is read, the result's check, the damage)."""
    for file, text in EXAMPLES.values():  # some read a second one beside them
        (folder / file).write_text(text)
    lenses = ("camodocal camera", "Gyroflow lens profile", "Metashape lens")
    found = {"ocam": ("ocam1.txt", OCAM_TXT, read_any_camera, check_camera)}
    for name in EXAMPLES.keys() - {"a folder", "COLMAP model"}:
        kind = (read_any_camera, check_camera) if name in lenses else (in_metres, check_rig)
        found[name] = (*EXAMPLES[name], *kind)
    found["in lines"] = ("config.yaml", yaml.safe_dump(omnimvs()), read_any_rig, check_rig)
    found |= ocam_poses(folder) | corners(folder) | data_set(folder)
    found |= tensors(folder) | records() | netpbm() | hand_in()
    return {name: (*sample, damage)[:5] for name, sample in found.items()}


def in_metres(path):
    """Read a rig, in metres where its format does not state the unit."""
    try:
        return read_any_rig(path)
    except osl.OmnistereoError as error:
        if "does not state its unit" not in str(error):
            raise
        return read_any_rig(path, "m")


def ocam_poses(folder):
    (folder / "rig").mkdir()
    for i in (1, 2, 3, 4):
        (folder / "rig" / f"ocam{i}.txt").write_text(OCAM_TXT)
    checked = lambda path: read_any_rig(path.parent, "cm"), check_rig
    return {"poses": ("rig/poses.txt", POSES_TXT, *checked)}


def corners(folder):
    board = Checkerboard((4, 3), 0.06)
    views = {f"{k:04}": 10.0 + 5 * k + 20 * board.points[:, :2] / 0.06 for k in range(3)} | {
        "0009": None
    }
    save_corners(folder / "corners.yaml", views, board, (200, 192))
    text = (folder / "corners.yaml").read_text()
    return {"corners": ("corners.yaml", text, load_corners, check_corners)}


def data_set(folder):
    """A set whose config.yaml names the folder of its ground truth."""
    for k in (1, 2, 3):
        (folder / "set" / f"cam{k}").mkdir(parents=True)
        (folder / "set" / f"cam{k}" / "0001.png").write_bytes(b"")
    write = json.dumps(omnimvs(dataset={"truth": "."}))
    checked = lambda path: osl.load_dataset(path.parent).rig, check_rig
    return {"data set": ("set/config.yaml", write, *checked)}


def tensors(folder):
    """Weights, and the state and log of a training."""
    network = osl.MCCNN()
    network.save(folder / "weights.safetensors", recipe=RECIPE.as_dict())
    content = (folder / "weights.safetensors").read_bytes()
    checked = osl.MCCNN.from_file, check_network, damage_tensors
    found = {"weights": ("weights.safetensors", content, *checked)}
    run = _Run.__new__(_Run)  # without data
    run.recipe, run.network, run.init_sha256 = RECIPE, network, None
    run.samples, run.precision = SimpleNamespace(metadata={"sha256": "0"}), "float32"
    run.optimizer = torch.optim.AdamW(network.parameters())
    sum(weight.sum() for weight in network.parameters()).backward()
    run.optimizer.step()
    run.save_state(folder / "state.safetensors", 2, {"loss": 0.5})
    content = (folder / "state.safetensors").read_bytes()
    found["state"] = (
        "state.safetensors",
        content,
        lambda path: run.resume(path)[0],
        check_step,
        damage_tensors,
    )
    rows = [[step, 0.5, 0.1, 1e-3, 2.0, "", 0.3] for step in range(4)]
    write_csv(folder / "log.csv", COLUMNS, rows)
    content = (folder / "log.csv").read_bytes()
    return found | {"log": ("log.csv", content, lambda path: read_log(path, 4), check_log)}


def hand_in():
    cells = [
        {"cell_type": "markdown", "source": ["# 04 · ZNCC", "\n"]},
        {"cell_type": "code", "source": "1 + 1"},
    ]
    text = json.dumps({"cells": cells, "nbformat": 4, "nbformat_minor": 5, "metadata": {}})

    def read(path):
        cells = handin.read_cells(path)
        handin.original_of(cells, path)
        list(handin.other_version([source for _, source in cells], []))
        return cells

    return {"hand-in": ("04.ipynb", text, read, check_cells)}


def live_page(address):
    """A request to the live view and its answer: the status, None without one, the content."""
    port = urlsplit(address).port
    request = b"GET /depth?0.5&0.8 HTTP/1.1\r\nHost: localhost\r\nAccept: */*\r\n\r\n"

    def ask(path):
        with socket.create_connection(("127.0.0.1", port), 60) as client:
            client.sendall(path.read_bytes())
            client.shutdown(socket.SHUT_WR)
            answer = client.makefile("rb").read()
        head, _, body = answer.partition(b"\r\n\r\n")
        status = re.match(rb"HTTP/1\.[01] ([0-9]{3}) ", head)
        return (int(status[1]), body) if status else (None, answer)

    return {"request": ("request", request, ask, check_answer, damage)}


def netpbm():
    """Two pictures of six values, one as bytes."""
    text = "P3 # as text\n3 2\n300\n" + " ".join(str(17 * k) for k in range(18))
    content = b"P6\n3 2 255\n" + bytes(range(18))
    samples = {"netpbm text": text, "netpbm": content}
    return {name: ("a.ppm", it, read_as_pillow, check_image) for name, it in samples.items()}


def read_as_pillow(path):
    """Return what the library reads, which is what Pillow does, on its scale."""
    read = read_image(path)
    if b"#" in path.read_bytes()[12:]:  # Pillow joins the digits on both sides of a comment
        return read
    other = np.asarray(Image.open(path), np.float64)
    assert read.shape == other.shape
    most = 65535 / 255 if other.max() > 255 else 1.0
    assert np.abs(read - other / most).max() <= 0.51
    return read


def records():
    from omnistereo_learn.evaluate.regions import METRICS, REGIONS, SUMS

    errors = {
        "figures": dict.fromkeys(METRICS, 1.5),
        "strata": {name: dict.fromkeys(SUMS, 3.0) for name in REGIONS},
    }
    config = {"width": 96, "height": 24, "num_spheres": 12, "rig": "own"}
    method = {"cost": "zncc", "aggregate": "sgm", "window": None}
    frames = {"sunny": {"00001": {"zncc+sgm": errors}, "00002": {"zncc+sgm": errors}}}
    record = {"config": config, "methods": {"zncc+sgm": method}, "frames": frames}
    record |= {"data": {}, "weights": {}}
    return {"results": ("results.json", json.dumps(record), read_record, check_results)}


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    folder, latest = tmp_path_factory.mktemp("fuzz"), Latest()
    sweep = osl.SphereSweep(scene.rig(), osl.SphereGrid(32, 8, num_spheres=4, min_depth=1.0))
    two_metres = np.full(sweep.grid.shape, sweep.grid.depth_to_index(2.0), np.float32)
    latest.put(LivePicture(b"", osl.Depth(two_metres, np.ones_like(two_metres), sweep, ())))
    with serve(latest) as address:
        yield folder, samples(folder) | live_page(address)


def peak():
    """Return the most bytes of address space that this process has had."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.search(r"VmPeak:\s*([0-9]+)", status)[1])


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_damaged_files_are_refused_or_read_as_finite_numbers(valid, limits, capfd):
    folder, known = valid
    for name, (file, content, read, check, harm) in known.items():
        path, content = folder / file, content.encode() if isinstance(content, str) else content
        path.write_bytes(content)
        check(read(path))  # the valid file is read
        most = max(peak(), psutil.Process().memory_info().vms + MEMORY)
        for number in range(FILES):
            path.write_bytes(harm(content, random.Random(f"{name} {number}")))
            limits(memory=4 * MEMORY)
            try:
                result = read(path)
            except osl.OmnistereoError as error:
                assert 10 < len(str(error)) <= 500 and len(str(error).splitlines()) == 1, (
                    f"{name} {number}"
                )
                continue
            except Exception as error:
                raise AssertionError(f"{name} {number}: {type(error).__name__}: {error}") from error
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    check(result)
                except Exception as error:
                    raise AssertionError(f"{name} {number}: what was read: {error!r}") from error
        path.write_bytes(content)
        assert peak() <= most and capfd.readouterr() == ("", ""), name
