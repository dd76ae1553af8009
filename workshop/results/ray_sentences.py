"""How often the sentence about a ray is right, by kind, on frames with exact depth.

The estimate is right where it is off by at most two spheres or a tenth of the depth. A sentence is
right where nothing that it says is contradicted by its curve or by the exact depth:

- unseen: fewer than two cameras see the exact point; flat: there is little texture there, too;
- agrees, decided: the depth is right;
- unlike: what is said of the curve is true by how it is found, so what is looked up is the bound
  that stands below it; either, elsewhere, wide: that, or another depth that is named is right;
- weak: it is not nearer than is said;
- notes: the other depth is, or is not, among the exact depths around.
"""

import json
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np

from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.files import write_text
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.pipeline import estimate_depth
from omnistereo_tools.judge.ray import FLAT, NOTES, SENTENCES, Ray, explain, tolerance
from workshop.render.image_sets import renew_manifest
from workshop.results.error_bars import DATA, HEIGHT, JUDGED, SPHERES, WIDTH

RESULTS = DATA / "results" / "ray_sentences.json"
_METHOD = "volumenet"
_SEED = 2  # of the rays that the book reports: the rules were set while looking at others


def run(rays: int) -> None:
    """Judge the sentences of so many random rays of each frame, and store the shares."""
    found: dict[str, list[list[bool]]] = defaultdict(list)
    of_notes: dict[str, list[bool]] = defaultdict(list)
    for of_set, numbers in JUDGED.items():
        for number in numbers:
            for kind, verdict, note, holds in judge_frame(of_set, number, rays):
                found[kind].append(verdict)
                of_notes[note].append(holds)
            print(of_set, number, sum(map(len, found.values())), "rays", flush=True)
    total = sum(map(len, found.values()))
    told_none = sum(right for right, *_ in found["unlike"])
    results = {
        "rays": total,
        "method": _METHOD,
        "right depths told that the cameras hardly agree, %": round(
            100 * told_none / sum(right for of in found.values() for right, *_ in of), 1
        ),
        "kinds": {
            kind: dict(
                zip(
                    ("rays", "depth right, %", "sentence right, %", "within the bound, %"),
                    (len(of), *(round(100 * float(np.mean(x))) for x in zip(*of, strict=True))),
                    strict=True,
                )
            )
            for kind, of in ((kind, found[kind]) for kind in SENTENCES)
            if of
        },
        "notes": {
            note: {"rays": len(of), "right, %": round(100 * float(np.mean(of)))}
            for note, of in ((note, of_notes[note]) for note in NOTES)
            if note and of
        },
    }
    write_text(RESULTS, json.dumps(results, indent=1) + "\n")
    renew_manifest(DATA)
    print(table())


def judge_frame(of_set: str, number: int, rays: int) -> Iterator[tuple[str, list[bool], str, bool]]:
    """Yield the kind of each sentence, whether depth and sentence are right, and the bound, and its
    note, and whether that is right.
    """
    frame = load_dataset(DATA / of_set, split="test").frame(number)
    grid = SphereGrid(WIDTH, HEIGHT, num_spheres=SPHERES, min_depth=frame.rig.min_depth or 1.0)
    depth, truth = estimate_depth(frame, grid, _METHOD), frame.gt_index(grid)
    exact = Depth(truth.astype(np.float32), depth.confidence, depth.sweep, frame.images)
    usable = np.flatnonzero(np.isfinite(truth) & (truth >= 0) & (truth < SPHERES) & depth.valid)
    for cell in np.random.default_rng([_SEED, number]).choice(usable, rays, replace=False):
        row, column = divmod(int(cell), grid.width)
        one, other = explain(depth, column, row), explain(exact, column, row)
        off = abs(one.index - other.index)
        right = bool(off <= tolerance(max(one.index, other.index)))
        within = bool(off * grid.step <= depth.bound[row, column])
        verdict = [right, is_right(one, other, right, within), within]
        yield one.kind, verdict, one.note, note_holds(one, other)


def is_right(one: Ray, exact: Ray, right: bool, within: bool) -> bool:
    """Return whether a sentence is right, given what is said of the exact point of its ray."""
    if one.kind == "unseen":
        return bool(exact.sees.sum() < 2)
    if one.kind == "wide":
        beside = abs(exact.index - np.clip(exact.index, *one.plateau))
        return within or bool(beside <= tolerance(exact.index))
    if one.kind == "flat":
        return exact.contrast < 2 * FLAT
    if one.kind in ("agrees", "decided"):
        return right
    if one.kind == "weak":
        return note_holds(one, exact)
    named = one.kind in ("either", "elsewhere") and one.rival is not None
    return bool(within or (named and abs(one.rival.sphere - exact.index) <= tolerance(exact.index)))


def note_holds(one: Ray, exact: Ray) -> bool:
    """Return whether the note of a sentence is right, given the exact depths of the rays around."""
    if one.note == "nearest":
        return exact.depth >= one.nearest
    if one.rival is None:
        return True
    there = np.abs(exact.around - one.rival.sphere) <= tolerance(exact.around)
    return bool(there.any()) == (one.note == "edge")


def table() -> str:
    """Return the table of the book: each kind of sentence, and how often it is right."""
    results: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    rows = ["| sentence | rays | depth right | sentence right |", "|---|---|---|---|"]
    for kind, of in results["kinds"].items():
        text = SENTENCES[kind].format(
            count="three", depth="5.89 m", other="12.8 m", nearer="3.02 m", farther="31.0 m"
        )
        count, right, sentence, _ = of.values()
        share = 100 * count / results["rays"]
        rows.append(f"| {text} | {share:.0f} % | {right} % | {sentence} % |")
    for note, of in results["notes"].items():
        text = NOTES[note].strip().format(depth="5.89 m", other="12.8 m", nearest="4.71 m")
        share = 100 * of["rays"] / results["rays"]
        rows.append(f"| … {text} | {share:.0f} % | | {of['right, %']} % |")
    return "\n".join(rows) + "\n"
