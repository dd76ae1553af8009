"""Everything that `omnistereo depth` writes for one frame: a page to look at, a viewer, and the data behind them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.files import atomic_write, make_folder, write_image
from omnistereo_lib.frame import write_inverse_depth
from omnistereo_lib.lazy import lazy_property
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_lib.rig_files import save_rig
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.metrics import index_error
from omnistereo_tools.judge.trust import DOUBTFUL, odds, trust
from omnistereo_tools.output.blend import blended_panorama
from omnistereo_tools.output.overview import draw_overview
from omnistereo_tools.output.pictures import ColorScale, sharp_panorama
from omnistereo_tools.output.points import Limits, PointCloud
from omnistereo_tools.output.summary import depth_sentences, error_sentences, turn_sentence
from omnistereo_tools.output.viewer import viewer_page

_SHARP = 1800  # px, width of the panorama that is looked at

_README = """\
Panoramas have {height} rows, from {phi[0]:g}° to {phi[1]:g}° (down is positive), and {width} columns around the circle.
The centre column looks along +z of the rig, those to its right towards +x. Depth is measured along the ray, from the
mean of the camera centres.

inverse_depth.tiff   float32, 1/m; 0 = infinitely far, NaN = no two cameras see the ray. Depth in metres is 1 / value.
confidence.tiff      float32 in [0, 1], of the method {method}; NaN as above
inverse_depth.png    the same as colours: near is bright, far is dark, striped is unknown; to look at, not to measure
panorama.jpg         the cameras' colours at the depth of each ray, blended, one pixel per ray; black = unknown
points.ply           {points} points, binary PLY: metres (x right, y down, z forward), normals towards the rig, colours,
                     confidence, and 1 where doubtful; rays up to {max_depth:.3g} m with a confidence of at least
                     {min_confidence:.3g}
trust.tiff           float32 in [0, 1]: the confidence judged at equal range, 0 where cameras see black or white alone;
                     below 0.5 a ray is doubtful, that is, about as likely wrong as right
rig.yaml             the cameras with their origin moved to the centre of the panorama; T_rig_file (axis-angle, metres)
                     takes coordinates of your rig file to those of the panorama and the points
"""
_ERRORS = "errors.json          errors against the ground truth in % of the range swept, as in Table II of the paper\n"


@dataclass(frozen=True, eq=False)
class FrameResult:
    """The depth of one frame, and what is said and written about it."""

    depth: Depth
    limits: Limits
    method: str
    gt_index: NDArray[Any] | None = None

    @property
    def title(self) -> str:
        """One line for the head of pictures and pages."""
        grid = self.depth.grid
        rays = f"{grid.width} × {grid.height} rays"
        turned = ", rig turned level" if turn_sentence(self.depth.sweep.rig) else ""
        return f"{self.method}: {len(self.depth.images)} cameras{turned}, {rays}, {grid.num_spheres} spheres"

    def sentences(self) -> list[str]:
        """Return the result in plain sentences."""
        errors = [] if self.gt_index is None else error_sentences(self.depth, self.gt_index)
        return depth_sentences(self.depth, self.limits, self.doubtful) + errors

    @lazy_property
    def trust(self) -> NDArray[np.float32]:
        """How far the depth of each ray is trusted, (H, W), in [0, 1]; see `trust`."""
        return trust(self.depth, self.method)

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """Which rays are doubtful, (H, W)."""
        return self.trust < DOUBTFUL

    @lazy_property
    def panorama(self) -> NDArray[np.uint8]:
        """The panorama that is looked at, sharper than the depth, RGB; it is the texture of a mesh, too."""
        return sharp_panorama(self.depth, _SHARP)

    @lazy_property
    def _colors(self) -> NDArray[np.float32]:
        return blended_panorama(self.depth)

    @lazy_property
    def _cloud(self) -> PointCloud:
        return PointCloud.of(self.depth, self._colors, self.limits, self.doubtful)

    def write(self, out: Path, progress: Progress = silent) -> list[str]:
        """Write everything into a folder; return the names of what was written, the first to look at first."""
        steps = {"data": self._write_data, "overview.png": self._write_overview, "index.html": self._write_page}
        step = counted(progress, len(steps))
        for name, write in steps.items():
            step(name)
            write(make_folder(out) / name)
        step("")
        return ["overview.png", "index.html (open it in a browser)", "data/ (README.txt says what each file holds)"]

    def _write_overview(self, path: Path) -> None:
        page = draw_overview(self.depth, self.panorama, self._cloud, self.trust, self.title, self.sentences())
        write_image(path, page)

    def _write_page(self, path: Path) -> None:
        page = viewer_page(
            self.depth,
            self.panorama,
            self.limits,
            self.title,
            trust=self.trust,
            odds=odds(self.method),
            gt_index=self.gt_index,
        )
        with atomic_write(path) as temporary:
            temporary.write_text(page, encoding="utf-8")

    def _write_data(self, data: Path) -> None:
        make_folder(data)
        depth, grid = self.depth, self.depth.grid
        write_inverse_depth(data / "inverse_depth.tiff", depth.inverse_depth)
        write_inverse_depth(data / "confidence.tiff", depth.confidence)
        write_inverse_depth(data / "trust.tiff", self.trust)
        write_image(data / "inverse_depth.png", ColorScale.of(depth.inverse_depth).colorize(depth))
        write_image(data / "panorama.jpg", self._colors)
        self._cloud.write(data / "points.ply")
        save_rig(depth.sweep.rig, data / "rig.yaml")
        text = _README.format(
            width=grid.width,
            height=grid.height,
            phi=grid.phi_deg,
            method=self.method,
            points=len(self._cloud.points),
            max_depth=self.limits.max_depth,
            min_confidence=self.limits.min_confidence,
        )
        (data / "errors.json").unlink(missing_ok=True)  # of another frame
        if self.gt_index is not None:
            found = index_error(depth.index, self.gt_index, grid.num_spheres)
            errors = {name: value if isfinite(value) else None for name, value in found.items()}  # JSON has no NaN
            with atomic_write(data / "errors.json") as temporary:
                temporary.write_text(json.dumps(errors, indent=1) + "\n")
            text += _ERRORS
        with atomic_write(data / "README.txt") as temporary:
            temporary.write_text(text, encoding="utf-8")
