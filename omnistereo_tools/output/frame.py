"""What `omnistereo depth` writes for one frame: overview, viewer, data, and exports."""

import json
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from omnistereo_learn.provenance import (
    PROVENANCE,
    arrays_checksum,
    differences,
    notes,
    provenance,
    read_facts,
    write_facts,
)
from omnistereo_lib.files import checksum, make_folder, read_bytes, write_text
from omnistereo_lib.frame import write_inverse_depth
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.lazy import lazy_property
from omnistereo_lib.pictures import write_image
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_lib.rig_file import save_rig
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.learned import choose_precision
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.metrics import index_error
from omnistereo_tools.judge.coverage import turn_sentence
from omnistereo_tools.judge.trust import DOUBTFUL, trust
from omnistereo_tools.output.blend import blended_panoramas, estimate_gains
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.crops import write_crops
from omnistereo_tools.output.mesh_export import write_mesh
from omnistereo_tools.output.overview import draw_overview
from omnistereo_tools.output.pictures import as_picture, finer, in_millimetres, write_panorama
from omnistereo_tools.output.points import AXES_IN_WORDS, Limits, PointCloud
from omnistereo_tools.output.summary import (
    depth_facts,
    depth_sentences,
    doubt_shares,
    error_sentences,
    fits,
)
from omnistereo_tools.output.viewer import WIDEST, viewer_page
from omnistereo_tools.output.webp import Fisheye
from omnistereo_tools.outputs import photo_and_colors
from omnistereo_tools.parser import is_own

# of the panorama that is looked at: columns for a pixel of the images
_SHARP = 1.4

_README = """\
Panoramas have {height} rows, from {phi[0]:g}° to {phi[1]:g}° (down is positive), and {width} \
columns around the circle.
The centre column looks along +z of the rig, those to its right towards +x. Depth is measured along
the ray, from the mean of the camera centres.

TIFF files of float32 state NaN as nodata; OpenCV reads them with cv2.IMREAD_UNCHANGED alone.

inverse_depth.tiff   float32, 1/m; 0 = infinitely far, NaN = no two cameras see the ray.
                     Depth in metres is 1 / value
confidence.tiff      float32 in [0, 1], of the method {method}; NaN as above
inverse_depth.png    the same as colours: near is bright, far is dark, striped is unknown; to look
                     at, not to measure
depth_mm.png         16 bits: depth along the ray in whole millimetres; 0 = unknown, or beyond 65 m
panorama.jpg         the cameras' colours at the depth of each ray, blended, one pixel per ray;
                     black = unknown
points.ply           {points} points, binary PLY: metres ({axes}), normals towards the rig,
                     colours, confidence as quality, and 1 where doubtful; rays up to \
{max_depth:.3g} m
sigma.tiff           float32, 1/m: 68 % of the rays are off by at most this much in inverse depth;
                     NaN as above
bound.tiff           float32, 1/m: 95 % are. From the method's evidence, and from how far the rig
                     file says that its cameras may be off; the truth is taken to lie within the
                     range swept
trust.tiff           float32 in [0, 1]: how likely the depth is right, off by at most a tenth or
                     two spheres, by its error bars; 0 where cameras see black or white alone;
                     below 0.5 a ray is doubtful
rig.yaml             the cameras with their origin moved to the centre of the panorama; T_rig_file
                     (axis-angle, metres) takes coordinates of your rig file to those of the
                     panorama and the points
provenance.json      what all this was made from: the version, checksums of rig and images, the
                     method
"""
_ERRORS = """\
errors.json          errors against the ground truth in % of the range swept, as in Table II of
                     the paper
"""


@dataclass(frozen=True, eq=False)
class FrameResult:
    """The depth of one frame, and what is said and written about it."""

    depth: Depth
    limits: Limits
    method: str
    gt_index: NDArray[Any] | None = None
    up: Literal["z"] | None = None  #: of points and meshes in PLY; None: the axes of the rig
    doubt: str | None = None  #: why the rig and the images cannot fit
    beside: dict[str, Any] | None = None  #: another run, as `data_of` its page has it
    images: Sequence[Future[Fisheye]] | None = None  #: of `fisheye_images`, if begun already

    @property
    def title(self) -> str:
        """One line for the head of pictures and pages."""
        turned = ", rig turned level" if turn_sentence(self.depth.sweep.rig) else ""
        name = self.method if is_own(self.method) else Method.parse(self.method).label
        return f"Depth from {len(self.depth.images)} cameras by {name}{turned}"

    @lazy_property
    def facts(self) -> dict[str, Any]:
        """What decides the numbers, as `provenance.json` holds it."""
        grid, device = self.depth.grid, self.depth.sweep.device
        own = is_own(self.method)
        name = f"{self.method} {checksum(read_bytes(self.method))[:16]}" if own else self.method
        network = not own and Method.parse(self.method).has_weights
        sizes = {"width": grid.width, "height": grid.height, "phi_deg": list(grid.phi_deg)}
        sizes |= {"spheres": grid.num_spheres, "min_depth": grid.min_depth}
        made = provenance(
            self.depth.sweep.rig,
            arrays_checksum(self.depth.images),
            name,
            choose_precision("auto", device) if network else None,
            torch.get_num_threads() if network else None,
        )
        return sizes | {"provenance": made}

    def replaces(self, out: Path) -> str | None:
        """Return in words what other depth a folder holds, which `write` replaces, if any."""
        stored = read_facts(out / "data" / PROVENANCE)
        other = differences(stored, self.facts) + notes(stored, self.facts) if stored else []
        return f"the depth that is in {out}/ is replaced: {'; '.join(other)}" if other else None

    @lazy_property
    def sentences(self) -> list[str]:
        """The result in plain sentences."""
        errors = [] if self.gt_index is None else error_sentences(self.depth, self.gt_index)
        return depth_sentences(self.depth, self.limits, self.doubtful, self.doubt) + errors

    @property
    def fits(self) -> bool:
        """Whether the rig and the images seem to fit: at most half of the rays are doubtful."""
        return not self.doubt and fits(doubt_shares(self.depth.depth, self.doubtful)[0])

    @lazy_property
    def trust(self) -> NDArray[np.float32]:
        """How far the depth of each ray is trusted, (H, W), in [0, 1]; see `trust`."""
        return trust(self.depth)

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """Which rays are doubtful, (H, W)."""
        return self.trust < DOUBTFUL

    @lazy_property
    def panorama(self) -> NDArray[np.uint8]:
        """The panorama that is looked at, RGB, sharper than the depth; a mesh's texture."""
        return self._blended[1]

    @lazy_property
    def _blended(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """The blended panorama of a ray a pixel, and the sharper one."""
        held = 360 * max(camera.pixels_per_degree for camera in self.depth.sweep.rig.cameras)
        factors = 1, finer(self.depth, round(min(_SHARP * held, WIDEST)))
        colors, sharp = blended_panoramas(self.depth, estimate_gains(self.depth), factors)
        return colors, as_picture(sharp)

    @property
    def _colors(self) -> NDArray[np.float32]:
        return self._blended[0]

    @lazy_property
    def _cloud(self) -> PointCloud:
        return PointCloud.of(self.depth, self._colors, self.limits, self.doubtful)

    def write(self, out: Path, progress: Progress = silent) -> list[str]:
        """Write everything into a folder; return the names, the first to look at first."""
        step = counted(progress, 3)
        folder = make_folder(out)
        _ = self.depth.samples  # which both of the next two need
        with ThreadPoolExecutor(1) as pool:
            # Beside the panorama what takes no colours, then the overview beside the rest.
            maps = pool.submit(self._write_maps, make_folder(folder / "data"))
            step("data")
            _ = self.panorama, maps.result(), self._cloud
            overview = pool.submit(self._write_overview, folder / "overview.png")
            self._write_data(folder / "data")
            step("index.html")
            self._write_page(folder / "index.html")
            step("overview.png")
            overview.result()
        step("")
        return ["overview.png", "index.html", "data/ (README.txt says what each file holds)"]

    def export(
        self,
        mesh_file: Path | None = None,
        equirectangular: Path | None = None,
        crops: Path | None = None,
        las: Path | None = None,
    ) -> list[str]:
        """Write the files for other programs that are asked for, into folders that exist; return
        what each holds. See `write_mesh`, `equirectangular_depth` and `write_crops`.
        """
        written = []
        if mesh_file is not None:
            triangles, doubtful = write_mesh(
                mesh_file, self.depth, self.panorama, self.limits, self.doubtful, self.up
            )
            written.append(
                f"{mesh_file} ({triangles} triangles, {doubtful} of them doubtful and marked)"
            )
        if equirectangular is not None:
            photo, colors = self._write_equirectangular(equirectangular)
            written.append(f"{equirectangular} (metres along the ray), {photo}, {colors}")
        if crops is not None:
            count = write_crops(crops, self.depth, self.limits, self._cloud)
            written.append(f"{crops}/ ({count} crops of all that the cameras see; transforms.json)")
        if las is not None:
            self._cloud.write_las(las)
            written.append(f"{las} (points with z up)")
        return written

    def _write_equirectangular(self, path: Path) -> tuple[Path, Path]:
        """Write depth of the whole sphere, and beside it two pictures that 360° viewers open: what
        the cameras see, and depth in colours; return the paths of the two.
        """
        whole = equirectangular_depth(self.depth)
        write_inverse_depth(path, whole)
        inverse = 1 / whole
        rays = SphereGrid(whole.shape[1], whole.shape[0], (-90.0, 90.0)).rays()
        photo, inside = self.depth.grid.look_up(self._colors, rays)
        names = photo_and_colors(path)
        write_image(names[0], np.where(inside.T, photo.T, 0).T)
        write_image(names[1], ColorScale.of(inverse).colorize(inverse))
        return names

    def _write_overview(self, path: Path) -> None:
        facts = depth_facts(self.depth, self.limits, self.doubtful, self.gt_index)
        what = self.depth, self.panorama, self.trust, self.title, self.sentences[0], facts
        write_image(path, draw_overview(*what))

    def _write_page(self, path: Path) -> None:
        more: dict[str, Any] = {"trust": self.trust, "gt_index": self.gt_index}
        more |= {"beside": self.beside, "images": self.images}
        page = viewer_page(self.depth, self.panorama, self.limits, self.title, **more)
        write_text(path, page)

    def _write_maps(self, data: Path) -> None:
        depth, inverse_depth = self.depth, self.depth.inverse_depth
        write_inverse_depth(data / "inverse_depth.tiff", inverse_depth)
        write_inverse_depth(data / "trust.tiff", self.trust)
        for name in ("confidence", "sigma", "bound"):
            write_inverse_depth(data / f"{name}.tiff", getattr(depth, name))
        colors = ColorScale.of(inverse_depth).colorize(inverse_depth)
        write_image(data / "inverse_depth.png", colors)
        write_image(data / "depth_mm.png", in_millimetres(depth.depth))

    def _write_data(self, data: Path) -> None:
        depth, grid = self.depth, self.depth.grid
        write_panorama(data / "panorama.jpg", self._colors, grid)
        self._cloud.write(data / "points.ply", self.up)
        save_rig(depth.sweep.rig, data / "rig.yaml")
        sizes = {"width": grid.width, "height": grid.height, "phi": grid.phi_deg}
        points = {"points": len(self._cloud.points), "max_depth": self.limits.max_depth}
        text = _README.format(method=self.method, axes=AXES_IN_WORDS[self.up], **sizes, **points)
        (data / "errors.json").unlink(missing_ok=True)  # of another frame
        write_facts(data / PROVENANCE, self.facts)
        if self.gt_index is not None:
            found = index_error(depth.index, self.gt_index, grid.num_spheres)
            # JSON has no NaN
            errors = {name: value if isfinite(value) else None for name, value in found.items()}
            write_text(data / "errors.json", json.dumps(errors, indent=1) + "\n")
            text += _ERRORS
        write_text(data / "README.txt", text)


def equirectangular_depth(depth: Depth) -> NDArray[np.float32]:
    """Return depth along the ray in metres as a panorama of the whole sphere, shape (W / 2, W).

    Infinite where nothing is near, NaN where it is unknown, such as at the poles. Each ray takes
    the nearest pixel: depth between two surfaces would be in neither.
    """
    width = depth.grid.width
    found, inside = depth.grid.look_up(
        depth.depth, SphereGrid(width, width // 2, (-90.0, 90.0)).rays()
    )
    return np.where(inside, found, np.nan).astype(np.float32)
