"""What one library does: run by its own Python, without this project, as `measure.py NAME FILES`.

Prints JSON: rows of lenses, of poses and of files. A lens row has the pixel of a ray at 110° from
the axis of an equidistant lens (f 200, centre 320, 240), that pixel taken back, and the largest
field over which both agree. FILES is a folder of what we write, with what it must hold, truth.npz.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

POINTS = np.random.default_rng(0).normal(size=(50, 3)) * [2, 2, 0.5] + [0, 0, 3]
F, CX, CY, WIDE = 200.0, 320.0, 240.0, 110
ROWS = {"lenses": [], "poses": [], "files": []}


def ray(degrees):
    """The unit ray in the plane y = 0."""
    angle = np.radians(degrees)
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


def lens(library, model, order, centres, project, unproject, wide=None):
    """Measure one lens model; `wide` is the true pixel of the ray at 110° where that is known."""

    def attempt(function, *arguments):
        try:
            found = function(*arguments)
            found = np.asarray([] if found is None else found, float).ravel()
        except Exception as error:  # of any library
            return None, type(error).__name__
        if found.size == 0 or not np.isfinite(found).all() or np.abs(found).max() > 1e9:
            return None, "none"
        return found, ""

    def back(u):
        if unproject is None:
            return None, "has none"
        found, why = attempt(unproject, np.array([u, CY]))
        if found is None:
            return None, why
        found = np.append(found, 1.0) if found.size == 2 else found
        return float(np.degrees(np.arctan2(found[0], found[2]))), ""

    def there(degrees):
        found, why = attempt(project, ray(degrees))
        return (None, why) if found is None else (float(found[0]), "")

    pixel, why_pixel = there(WIDE)
    true = wide if wide is not None else pixel
    angle, why_angle = (None, "not tried") if true is None else back(true)
    field = 0
    for degrees in np.arange(0.5, 180):
        u, _ = there(degrees)
        found = None if u is None else back(u)[0]
        if found is None or abs(found - degrees) > 0.01:
            break
        field = int(2 * degrees)
    words = [f"{pixel:.2f}" if pixel is not None else why_pixel]
    words += [f"{angle:.1f}°" if angle is not None else why_angle]
    field = f"{field}°" if unproject else "not tried"
    ROWS["lenses"].append([library, model, order, centres, *words, field])


def pose(library, what, meaning):
    ROWS["poses"].append([library, what, meaning])


def file(name, tool, what, off, limit):
    """One file in one tool: how far it is off what we meant, and how far it may be."""
    ROWS["files"].append([name, tool, what, float(off), float(limit)])


EQUIDISTANT = CX + F * np.radians(WIDE)
KB = "fx fy cx cy k1 k2 k3 k4"


def of_pycolmap(folder, truth):
    import pycolmap

    name = f"pycolmap {pycolmap.__version__}"
    center = [CX + 0.5, CY + 0.5]

    def whole(uv):
        return None if uv is None else uv - 0.5

    models = {
        "OPENCV_FISHEYE": ([F, F, *center, 0, 0, 0, 0], EQUIDISTANT),
        "FISHEYE": ([F, F, *center], EQUIDISTANT),
        "SIMPLE_FISHEYE": ([F, *center], EQUIDISTANT),
        "SIMPLE_RADIAL_FISHEYE": ([F, *center, 0], EQUIDISTANT),
        "RADIAL_FISHEYE": ([F, *center, 0, 0], EQUIDISTANT),
        "THIN_PRISM_FISHEYE": ([F, F, *center, *[0] * 8], EQUIDISTANT),
        "RAD_TAN_THIN_PRISM_FISHEYE": ([F, F, *center, *[0] * 12], EQUIDISTANT),
        "EUCM": ([F, F, *center, 0.6, 1.0], None),
        "FOV": ([F, F, *center, 0.9], None),
        "SIMPLE_DIVISION": ([F, *center, -0.1], None),
        "DIVISION": ([F, F, *center, -0.1], None),
        "OPENCV": ([F, F, *center, 0, 0, 0, 0], None),
        "PINHOLE": ([F, F, *center], None),
        "EQUIRECTANGULAR": ([640, 480], None),
    }
    for model, (parameters, wide) in models.items():
        camera = pycolmap.Camera(model=model, width=640, height=480, params=parameters)
        lens(
            name,
            model,
            camera.params_info.replace(",", " ").replace("  ", " "),
            "halves",
            lambda r, camera=camera: whole(camera.img_from_cam(r)),
            lambda uv, camera=camera: camera.cam_ray_from_img(uv + 0.5),
            wide,
        )
    pose(
        name, "Rigid3d(cam_from_world)", "world → camera, quaternion x y z w; in images.txt w x y z"
    )
    model = pycolmap.Reconstruction(str(folder / "colmap"))
    file("colmap/", name, "cameras", abs(len(model.cameras) - 4), 0)
    camera = model.cameras[1]
    rays = np.array([camera.cam_ray_from_img(uv + 0.5) for uv in truth["pixels"]])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cosine = (rays * truth["rays"]).sum(1).clip(-1, 1)
    off = np.degrees(np.arccos(cosine)).max()
    file("colmap/cameras.txt", name, "rays within 85°, degrees", off, 0.03)
    database = folder / "colmap.db"
    database.unlink(missing_ok=True)
    options = pycolmap.ImageReaderOptions()
    options.camera_mask_path = str(folder / "colmap/masks/cam1.png")
    pycolmap.extract_features(
        str(database),
        str(folder / "images"),
        camera_mode=pycolmap.CameraMode.PER_FOLDER,
        reader_options=options,
        device=pycolmap.Device.cpu,
    )
    with pycolmap.Database.open(str(database)) as opened:
        points = opened.read_keypoints(opened.read_image_with_name("cam1/0001.png").image_id)[:, :2]
        at = np.floor(points).astype(int)
        seen = truth["mask"][at[:, 1], at[:, 0]]
        file(
            "colmap/masks", name, "features on what is masked", (~seen).sum() + (len(seen) < 50), 0
        )
        rigs = pycolmap.read_rig_config(str(folder / "colmap/rig_config.json"))
        pycolmap.apply_rig_config(rigs, opened)
        stored = opened.read_all_cameras()
        names = {each.model.name for each in stored}
        file("colmap/rig_config.json", name, "lenses in a database", names != {"OPENCV_FISHEYE"}, 0)


def of_opencv(folder, truth):
    import cv2

    name, zeros = f"opencv {cv2.__version__}", np.zeros(3)
    K = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1.0]])
    for k1 in (0.0, 0.1):
        D = np.array([k1, 0, 0, 0])
        t = np.radians(WIDE)
        lens(
            name,
            f"cv2.fisheye, k1 = {k1:g}",
            "K, k1 k2 k3 k4",
            "whole",
            lambda r, D=D: cv2.fisheye.projectPoints(r.reshape(1, 1, 3), zeros, zeros, K, D)[0],
            lambda uv, D=D: cv2.fisheye.undistortPoints(uv.reshape(1, 1, 2), K, D),
            CX + F * (t + k1 * t**3),
        )
    if hasattr(cv2, "omnidir"):
        xi, D = np.array([[1.0]]), np.zeros((1, 4))
        row = zeros.reshape(1, 3)
        lens(
            name,
            "cv2.omnidir, xi = 1",
            "K, xi, k1 k2 p1 p2",
            "whole",
            lambda r: cv2.omnidir.projectPoints(r.reshape(1, 1, 3), row, row, K, 1.0, D)[0],
            lambda uv: cv2.omnidir.undistortPoints(uv.reshape(1, 1, 2), K, D, xi, np.eye(3)),
        )
    pose(name, "R, T of stereoCalibrate", "camera 1 → camera 2, in the unit of the board")
    storage = cv2.FileStorage(str(folder / "opencv.yaml"), cv2.FILE_STORAGE_READ)
    second = storage.getNode("cam2")
    off = np.abs(
        np.column_stack([second.getNode(key).mat() for key in "RT"]) - truth["pose2"]
    ).max()
    file("opencv.yaml", name, "pose of camera 2, metres", off, 1e-9)
    depth = cv2.imread(str(folder / "data/depth_mm.png"), cv2.IMREAD_UNCHANGED) / 1000
    file(
        "depth_mm.png", name, "metres", np.abs(depth - truth["depth"])[truth["near"]].max(), 0.00051
    )
    inverse = cv2.imread(str(folder / "data/inverse_depth.tiff"), cv2.IMREAD_UNCHANGED)
    file("inverse_depth.tiff", name, "1/m", np.nanmax(np.abs(inverse - truth["inverse"])), 1e-7)
    for path in ("a.mp4", "a.webm"):
        shown = cv2.VideoCapture(str(folder / path)).read()[1][24, 20::40, ::-1].astype(int)
        file(
            f"--video {path[2:]}", name, "colours of 255", np.abs(shown - truth["colors3"]).max(), 4
        )

    if cv2.__version__ >= "5":
        network = cv2.dnn.readNetFromONNX(str(folder / "depth.onnx"))
        for name_of_input, image in images_by_name(truth).items():
            network.setInput(image, name_of_input)
        spheres(name, network.forward(["inverse_depth", "confidence"])[0], truth)


def images_by_name(truth):
    return {f"image{k}": image for k, image in enumerate(truth["images"], 1)}


def spheres(runtime, inverse_depth, truth):
    """How far the depth of an ONNX runtime is off that of torch: 32 spheres from 0.6 m on."""
    off = np.abs(inverse_depth * 0.6 * 31 - truth["spheres"])
    file("depth.onnx", runtime, "mean of all rays, in spheres", np.nanmean(off), 0.02)


def of_onnxruntime(folder, truth):
    import onnxruntime

    session = onnxruntime.InferenceSession(
        str(folder / "depth.onnx"), disabled_optimizers=["ConstantFolding"]
    )
    found = session.run(None, images_by_name(truth))[0]
    spheres(f"onnxruntime {onnxruntime.__version__}", found, truth)


def of_openvino(folder, truth):
    import openvino

    exact = {"INFERENCE_PRECISION_HINT": "f32"}
    model = openvino.Core().compile_model(str(folder / "depth.onnx"), "CPU", exact)
    found = model(list(truth["images"]))[model.output(0)]
    spheres(f"openvino {openvino.__version__.split('-')[0]}, f32", found, truth)


def of_tract(folder, truth):
    import tract

    model = tract.onnx().load(str(folder / "depth.onnx")).into_model().into_runnable()
    spheres("tract 0.23.9", model.run(list(truth["images"]))[0].to_numpy(), truth)


def of_gtsam(folder, truth):
    import gtsam

    name = f"gtsam {gtsam.__version__}" if hasattr(gtsam, "__version__") else "gtsam 4.3.0"
    for model, calibration, wide, order in (
        (
            "Cal3Fisheye",
            gtsam.Cal3Fisheye(F, F, 0, CX, CY, 0, 0, 0, 0),
            EQUIDISTANT,
            "fx fy s u0 v0 k1 … k4",
        ),
        (
            "Cal3Unified",
            gtsam.Cal3Unified(F, F, 0, CX, CY, 0, 0, 0, 0, 1.0),
            None,
            "fx fy s u0 v0 k1 k2 p1 p2 xi",
        ),
        ("Cal3DS2", gtsam.Cal3DS2(F, F, 0, CX, CY, 0, 0), None, "fx fy s u0 v0 k1 k2 p1 p2"),
    ):
        camera = getattr(gtsam, f"PinholeCamera{model}")(gtsam.Pose3(), calibration)
        lens(
            name,
            model,
            order,
            "as given",
            camera.project,
            lambda uv, c=camera: c.backproject(uv, 1.0),
            wide,
        )
    pose(name, "Pose3 of a camera", "camera → world, radians, tangent vectors: rotation first")


def of_aria(folder, truth):
    from projectaria_tools.core.calibration import CameraModelType as Type
    from projectaria_tools.core.calibration import CameraProjection

    name = "projectaria-tools 2.3.0"
    for kind, count, wide, order in (
        ("FISHEYE624", 12, EQUIDISTANT, "f cx cy k0 … k5 p0 p1 s0 … s3"),
        ("FISHEYE62", 8, EQUIDISTANT, "f cx cy k0 … k5 p0 p1"),
        ("SPHERICAL", 0, EQUIDISTANT, "fx fy cx cy"),
        ("KANNALA_BRANDT_K3", 4, EQUIDISTANT, "fx fy cx cy k0 … k3"),
        ("LINEAR", 0, None, "fx fy cx cy"),
    ):
        focal = [F] if "FISHEYE" in kind else [F, F]
        camera = CameraProjection(getattr(Type, kind), np.array([*focal, CX, CY, *[0.0] * count]))
        lens(name, kind, order, "whole", camera.project, camera.unproject, wide)
    pose(name, "T_Device_Camera", "camera → device, metres")
    numbers = np.array([F, CX, CY, 0.01, -0.02, 0.003, 0, 0, 1e-4, 1e-4, -2e-4, 2e-4, 0, -1e-4, 0])
    camera = CameraProjection(Type.FISHEYE624, numbers)
    pixels = [camera.project(point) for point in POINTS]
    np.savez(folder / "aria.npz", numbers=numbers, points=POINTS, pixels=pixels)


def of_ds_msp(folder, truth):
    import ds_msp

    name = "ds-msp 0.22.2"
    for kind, extra, wide, order in (
        ("KannalaBrandtModel", (), EQUIDISTANT, KB),
        ("UCMModel", (0.5,), None, "fx fy cx cy alpha"),
        ("EUCMModel", (0.6, 1.0), None, "fx fy cx cy alpha beta"),
        ("DoubleSphereModel", (-0.2, 0.6), None, "fx fy cx cy xi alpha"),
    ):
        model = getattr(ds_msp, kind)(F, F, CX, CY, *extra)

        def first(answer):
            values, valid = answer
            return values[0] if np.ravel(valid)[0] else []

        lens(
            name,
            kind.removesuffix("Model"),
            order,
            "whole",
            lambda r, m=model: first(m.project(r[None])),
            lambda uv, m=model: first(m.unproject(uv[None])),
            wide,
        )
    from ds_msp.io import kalibr

    path = str(folder / "kalibr.yaml")
    pixels, valid = kalibr.load_kalibr(path, "cam0").project(truth["rays"])
    off = np.linalg.norm(pixels - truth["pixels"], axis=1)
    file("kalibr.yaml", name, "pixels", off.max() if np.all(valid) else np.inf, 0.1)
    off = np.abs(kalibr.load_kalibr_extrinsics(path, "cam1")[:3] - truth["pose2"]).max()
    file("kalibr.yaml", name, "pose of camera 2, metres", off, 1e-9)


def of_mrcal(folder, truth):
    import mrcal

    name = "mrcal 2.5.2.post1"
    for kind, extra, wide, order in (
        ("LENSMODEL_PINHOLE", (), None, "fx fy cx cy"),
        ("LENSMODEL_STEREOGRAPHIC", (), None, "fx fy cx cy"),
        ("LENSMODEL_LONLAT", (), EQUIDISTANT, "fx fy cx cy, pixels a radian"),
        ("LENSMODEL_LATLON", (), None, "fx fy cx cy, pixels a radian"),
        ("LENSMODEL_OPENCV4", (0,) * 4, None, "fx fy cx cy k1 k2 p1 p2"),
        ("LENSMODEL_CAHVOR", (0,) * 5, None, "fx fy cx cy α β r0 r1 r2"),
        ("LENSMODEL_CAHVORE_linearity=0.37", (0,) * 8, None, "fx fy cx cy α β r0 r1 r2 e0 e1 e2"),
    ):
        numbers = np.array([F, F, CX, CY, *extra], float)
        lens(
            name,
            kind.removeprefix("LENSMODEL_"),
            order,
            "whole",
            lambda r, k=kind, n=numbers: mrcal.project(r, k, n),
            lambda uv, k=kind, n=numbers: mrcal.unproject(uv, k, n),
            wide,
        )
    pose(
        name,
        "rt_cam_ref of a cameramodel",
        "reference → camera, metres, Rodrigues; older files call it extrinsics",
    )


def of_kitti360(folder, truth):
    from kitti360scripts.helpers.project import CameraFisheye

    camera = CameraFisheye.__new__(CameraFisheye)  # which else reads a data set
    camera.fi = {
        "mirror_parameters": {"xi": 1.0},
        "distortion_parameters": {"k1": 0.0, "k2": 0.0, "p1": 0.1, "p2": 0.1},
        "projection_parameters": {"gamma1": 2 * F, "gamma2": 2 * F, "u0": CX, "v0": CY},
    }

    def project(r):
        return np.ravel(camera.cam2image(r[:, None])[:2])

    order = "xi, k1 k2, gamma1 gamma2 u0 v0; p1 p2 of its files are not used"
    lens("kitti360scripts 1.0.0", "MEI, xi = 1", order, "whole", project, None)


def of_formulas(folder, truth):
    """MATLAB's fisheyeIntrinsics by its documentation: rays (u'', v'', a0 + a2 ρ² + a3 ρ³ + a4 ρ⁴),
    stretched by [c d; e 1]; here r = 2 f tan(θ / 2).
    """
    a0, a2 = F, -1 / (4 * F)

    def project(r):
        n, z = np.hypot(*r[:2]), r[2]
        if n == 0:
            return [CX, CY]
        roots = np.roots([a2, -z / n, a0])  # a0 + a2 ρ² = ρ z / n
        rho = min(root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 0)
        return [CX + rho * r[0] / n, CY + rho * r[1] / n]

    def unproject(uv):
        x, y = uv - [CX, CY]
        return [x, y, a0 + a2 * (x * x + y * y)]

    order = "a0 a2 a3 a4, centre, c d e"
    lens("MATLAB, by its formula", "fisheyeIntrinsics", order, "whole from 1", project, unproject)
    pose("MATLAB, by its formula", "rigidtform3d of estimateExtrinsics", "world → camera")


def of_anipose(folder, truth):
    from aniposelib.cameras import CameraGroup, FisheyeCamera

    name = "aniposelib 0.8.0"
    matrix, size = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1]]), (640, 480)
    cameras = [
        FisheyeCamera(matrix=matrix, dist=np.array(k), size=size, rvec=r, tvec=t)
        for k in [[-0.01, 0.004, -0.002, 0.0003]]
        for r, t in (([0.0] * 3, [0.0] * 3), ([0.1, 0.5, -0.2], [-0.2, 0.01, 0.05]))
    ]
    group = CameraGroup(cameras)
    group.dump(str(folder / "anipose.toml"))
    pixels = [camera.project(POINTS).reshape(-1, 2) for camera in cameras]
    np.savez(folder / "anipose.npz", points=POINTS, pixels=pixels)
    plain = FisheyeCamera(
        matrix=matrix, dist=np.zeros(4), size=size, rvec=[0.0] * 3, tvec=[0.0] * 3
    )
    order = "matrix, distortions k1 k2 k3 k4"
    lens(name, "FisheyeCamera", order, "whole", lambda r: plain.project(r[None]), None)
    pose(name, "rotation, translation", "world → camera, in the unit of the board, Rodrigues")


def of_depthai(folder, truth):
    import depthai

    handler, sockets = depthai.CalibrationHandler(), depthai.CameraBoardSocket
    pair, matrix = (sockets.CAM_A, sockets.CAM_B), [[F, 0, CX], [0, F, CY], [0, 0, 1]]
    for socket in pair:
        handler.setCameraIntrinsics(socket, matrix, 640, 480)
        handler.setDistortionCoefficients(socket, [0.0] * 4)
        handler.setCameraType(socket, depthai.CameraModel.Fisheye)
    turn = [[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]
    handler.setCameraExtrinsics(pair[1], pair[0], turn, [7.5, 0.2, -1.0], [7.5, 0.0, 0.0])
    (folder / "oak.json").write_text(json.dumps(handler.eepromToJson()))
    T = np.array(handler.getCameraExtrinsics(pair[0], pair[1]))
    pixels = []
    for points in (POINTS, POINTS @ T[:3, :3].T + T[:3, 3] / 100):
        n = np.hypot(*points[:, :2].T)
        pixels.append([CX, CY] + points[:, :2] * (F * np.arctan2(n, points[:, 2]) / n)[:, None])
    np.savez(folder / "depthai.npz", points=POINTS, pixels=pixels)
    pose("depthai 3.12.0", "extrinsics of a camera", "camera → toCameraSocket, centimetres")


def of_plyfile(folder, truth):
    import plyfile

    found = plyfile.PlyData.read(str(folder / "data/points.ply"))["vertex"]
    off = np.abs(np.stack([found[axis] for axis in "xyz"], -1) - truth["points"]).max()
    file("points.ply", "plyfile 1.1.5", "metres", off, 1e-6)
    off = np.abs(found["quality"] - truth["quality"]).max()
    file("points.ply", "plyfile 1.1.5", "quality", off, 1e-6)


def of_laspy(folder, truth):
    import laspy

    las = laspy.read(str(folder / "points.laz"))
    x, y, z = truth["points"].T
    off = np.abs(las.xyz - np.column_stack([z, -x, -y])).max()
    file("--las a.laz", f"laspy {laspy.__version__}", "metres", off, 0.00051)
    off = np.abs(las.confidence - truth["quality"]).max()
    file("--las a.laz", f"laspy {laspy.__version__}", "confidence", off, 1e-6)


def of_open3d(folder, truth):
    import open3d
    from open3d.core import Tensor

    name = f"open3d {open3d.__version__}"
    matrix = Tensor(np.array([[F, 0, CX], [0, F, CY], [0, 0, 1.0]]))
    rays = open3d.t.geometry.RaycastingScene.create_rays_pinhole(
        matrix, Tensor(np.eye(4)), 640, 480
    )
    off = float(rays.numpy()[240, 320, 3] * F)
    pose(
        name,
        "RaycastingScene",
        f"world → camera; the ray of pixel (320, 240) passes {off:g} px beside the principal point",
    )
    cloud = open3d.t.io.read_point_cloud(str(folder / "data/points.ply")).point
    off = np.abs(cloud.positions.numpy() - truth["points"]).max()
    file("points.ply", name + " (tensor)", "metres", off, 1e-6)
    off = np.abs(cloud["quality"].numpy().ravel() - truth["quality"]).max()
    file("points.ply", name + " (tensor)", "quality", off, 1e-6)
    turned = np.asarray(open3d.io.read_point_cloud(str(folder / "points_z.ply")).points)
    x, y, z = truth["points"].T
    off = np.abs(turned - np.column_stack([z, -x, -y])).max()
    file("points.ply, --up z", name, "metres", off, 1e-6)
    depth = np.asarray(open3d.io.read_image(str(folder / "data/depth_mm.png"))) / 1000
    off = np.abs(depth - truth["depth"])[truth["near"]].max()
    file("depth_mm.png", name, "metres", off, 0.00051)
    scene = np.asarray(open3d.io.read_triangle_mesh(str(folder / "scene.ply")).vertices)
    file("--mesh a.ply", name, "metres", np.abs(scene - truth["scene"]).max(), 1e-5)
    mesh = open3d.io.read_triangle_mesh(str(folder / "mesh.ply"))
    off = np.abs(255 * np.asarray(mesh.vertex_colors) - truth["colors"]).max()
    file("mesh.ply", name, "colours of 255", off, 0.5)


def of_meshlab(folder, truth):
    import pymeshlab

    name = "pymeshlab 2025.7.post1"

    meshes = pymeshlab.MeshSet()  # its meshes go with it

    def load(path):
        meshes.load_new_mesh(str(folder / path))
        return meshes.current_mesh()

    off = np.abs(load("data/points.ply").vertex_scalar_array() - truth["quality"]).max()
    file("points.ply", name, "quality", off, 1e-6)
    for path, limit in (("mesh.ply", 0.5), ("mesh.glb", 1.0)):
        mesh = load(path)
        want = truth["colors"] if path == "mesh.ply" else 255 * truth["linear"]
        off = np.abs(255 * mesh.vertex_color_matrix()[:, :3] - want).max()
        file(
            path,
            name,
            "colours of 255" if path == "mesh.ply" else "linear light of 255",
            off,
            limit,
        )
        axes = np.eye(3) if path == "mesh.ply" else np.diag([1.0, -1, -1])
        off = np.abs(mesh.vertex_matrix() - truth["vertices"] @ axes).max()
        file(path, name, "metres", off, 1e-6)


def of_rasterio(folder, truth):
    import rasterio

    name = f"rasterio {rasterio.__version__}"
    for path in ("inverse_depth", "confidence", "trust"):
        with rasterio.open(folder / f"data/{path}.tiff") as opened:
            band = opened.read(1, masked=True)
        off = np.isnan(band.filled(0)).sum()
        file(f"{path}.tiff", name, "NaN pixels that are not masked", off, 0)


def of_evo(folder, truth):
    from evo.tools import file_interface

    name = "evo 1.38.1"
    pose(name, "TUM", "camera → world, metres; quaternion x y z w in the file, w x y z in Python")
    found = file_interface.read_tum_trajectory_file(str(folder / "trajectory.txt")).positions_xyz
    file("trajectory.txt", name, "metres", np.abs(found - truth["path"]).max(), 1e-6)
    timed = file_interface.read_tum_trajectory_file(str(folder / "trajectory_seconds.txt"))
    metres_a_second = 10 * np.linalg.norm(np.diff(truth["path"], axis=0), axis=1)
    off = np.abs(timed.speeds - metres_a_second).max()
    file("trajectory_seconds.txt", name, "speed, m/s", off, 1e-4)


def of_pyav(folder, truth):
    import av

    for path in ("a.mp4", "a.webm"):
        with av.open(str(folder / path)) as opened:
            stream = opened.streams.video[0]
            count = sum(1 for _ in opened.decode(stream))
            matrix = int(stream.codec_context.colorspace)
        file(f"--video {path[2:]}", f"PyAV {av.__version__}", "frames missing", abs(count - 3), 0)
        off = matrix not in (5, 6)
        file(f"--video {path[2:]}", f"PyAV {av.__version__}", "matrix not BT.601's", off, 0)


def of_panoramas(folder, truth):
    import py360convert

    wide = np.tile(np.arange(360.0), (180, 1))[..., None].repeat(3, -1)
    seen = py360convert.e2p(wide, 2.0, 0, 0, (3, 3), mode="bilinear")
    pose(
        "py360convert 1.0.4",
        "e2p, u, v",
        f"degrees, u to the right, v up; 0, 0 is column {seen[1, 1, 0]:.1f} of 360",
    )


def of_kornia(folder, truth):
    import kornia
    import torch
    from kornia.geometry.vector import Vector2, Vector3
    from kornia.image import ImageSize
    from kornia.sensors.camera.camera_model import KannalaBrandtK3

    numbers = torch.tensor([F, F, CX, CY, 0, 0, 0, 0], dtype=torch.float64)
    camera, one = KannalaBrandtK3(ImageSize(480, 640), numbers), torch.tensor(1.0)
    lens(
        f"kornia {kornia.__version__}",
        "KannalaBrandtK3",
        "fx fy cx cy k0 … k3",
        "whole",
        lambda r: camera.project(Vector3(torch.from_numpy(r))).data,
        lambda uv: camera.unproject(Vector2(torch.from_numpy(uv)), one).data,
        EQUIDISTANT,
    )


def of_rerun(folder, truth):
    import rerun

    matrix = rerun.Pinhole(focal_length=F, width=640, height=480).image_from_camera
    u, v = matrix.as_arrow_array().to_pylist()[0][6:8]
    pose(
        f"rerun {rerun.__version__}",
        "Pinhole, Transform3D",
        f"principal point ({u:g}, {v:g}) of 640 × 480 unless given; child → parent, quaternion "
        "x y z w",
    )


def of_blender(folder, truth):
    import bpy

    name = f"Blender {bpy.app.version_string}"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for model, order in (
        ("FISHEYE_LENS_POLYNOMIAL", "k0 … k4 of -θ by the radius in mm, sensor width"),
        ("FISHEYE_EQUIDISTANT", "angle of the width, and of the height"),
        ("FISHEYE_EQUISOLID", "f and sensor width in mm, largest angle"),
    ):
        angles, pixels = _rendered_row(bpy, model)
        lens(
            name,
            model,
            order,
            "halves",
            lambda r, a=angles, p=pixels: [
                np.interp(np.arctan2(r[0], r[2]), a, p, np.nan, np.nan),
                CY,
            ],
            lambda uv, a=angles, p=pixels: ray(np.degrees(np.interp(uv[0], p, a, np.nan, np.nan))),
            None if model.endswith("SOLID") else EQUIDISTANT,
        )
    pose(name, "camera.matrix_world", "camera → world, y up, looks along -z; metres")
    axes = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up: right, ahead, up

    def imported(operator, path):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        operator(filepath=str(folder / path))
        meshes = [item for item in bpy.data.objects if item.type == "MESH"]
        places = [m.matrix_world @ v.co for m in meshes for v in m.data.vertices]
        return meshes[0].data, np.array(places)

    def column(attribute, key):
        return np.array([getattr(item, key) for item in attribute.data])

    mesh, places = imported(bpy.ops.import_scene.gltf, "mesh.glb")
    colors = column(mesh.color_attributes[0], "color")[:, :3]
    file("mesh.glb", name, "metres", np.abs(places - truth["vertices"] @ axes.T).max(), 1e-6)
    file(
        "mesh.glb", name, "linear light of 255", 255 * np.abs(colors - truth["linear"]).max(), 0.01
    )
    _, places = imported(bpy.ops.import_scene.gltf, "scene.glb")
    off = [
        getattr(places, end)(0) - getattr(truth["scene"] @ axes.T, end)(0) for end in ("min", "max")
    ]
    file("--mesh a.glb", name, "bounding box, metres", np.abs(off).max(), 1e-4)
    mesh, places = imported(bpy.ops.wm.ply_import, "data/points.ply")
    quality = column(mesh.attributes["quality"], "value")
    file("points.ply", name, "metres", np.abs(places - truth["points"]).max(), 1e-6)
    file("points.ply", name, "quality", np.abs(quality - truth["quality"]).max(), 1e-6)
    image = bpy.data.images.load(str(folder / "whole.tiff"))
    image.colorspace_settings.name = "Non-Color"
    found = np.reshape(image.pixels[:], (*truth["whole"].shape, -1))[::-1, :, 0]
    known = np.isfinite(truth["whole"])
    off = np.abs(found - truth["whole"])[known].max()
    file("--equirectangular", name + " (Non-Color)", "metres", off, 1e-4)


def _rendered_row(bpy, model):
    """Return the angle from the axis of each pixel of a rendered row, and its place from CX."""
    width, folder = 1201, Path(tempfile.mkdtemp())
    scene, data = bpy.context.scene, bpy.data.cameras.new("eye")
    scene.world = bpy.data.worlds.new("directions")
    scene.world.use_nodes = True
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    halves = nodes.new("ShaderNodeVectorMath")
    halves.operation = "MULTIPLY_ADD"
    halves.inputs[1].default_value = halves.inputs[2].default_value = (0.5, 0.5, 0.5)
    links.new(nodes.new("ShaderNodeTexCoord").outputs["Generated"], halves.inputs[0])
    links.new(halves.outputs[0], nodes["Background"].inputs["Color"])
    scene.camera = bpy.data.objects.new("eye", data)
    scene.camera.rotation_euler = (np.pi / 2, 0, 0)  # ahead is y
    scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.cycles.use_denoising, scene.cycles.filter_width = False, 0.01
    scene.render.resolution_x, scene.render.resolution_y = width, 5
    scene.render.filepath = str(folder / "row.exr")
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    data.type, data.panorama_type, data.sensor_width = "PANO", model, 36
    data.fisheye_fov, data.fisheye_lens = width / F, 36 * F / width
    for k in range(5):
        setattr(data, f"fisheye_polynomial_k{k}", -width / F / 36 if k == 1 else 0.0)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    x, y, _ = 2 * np.reshape(image.pixels[:], (5, width, 4))[2, :, :3].T - 1
    shutil.rmtree(folder)
    seen = np.hypot(x, y) < 1.01  # what lies outside is black
    return np.arctan2(x, y)[seen], (np.arange(width) - (width - 1) / 2 + CX)[seen]


def of_nerfstudio(folder, truth):
    from nerfstudio.data.dataparsers import nerfstudio_dataparser

    name = "nerfstudio 1.1.5"

    def parsed(path):
        config = nerfstudio_dataparser.NerfstudioDataParserConfig(
            data=folder / path,
            orientation_method="none",
            center_method="none",
            auto_scale_poses=False,
            eval_mode="all",
            load_3D_points=path == "crops",
        )
        return config.setup().get_dataparser_outputs("train")

    u, v = truth["pixels"].astype(int).T
    rays = parsed("transforms.json").cameras.generate_rays(0).directions.numpy()[v, u]
    cosine = (rays * (truth["rays"] @ truth["poses"][0][:, :3].T)).sum(1).clip(-1, 1)
    off = np.degrees(np.arccos(cosine)).max()
    file("transforms.json", name, "rays within 85°, degrees", off, 0.03)
    crops, y_up = parsed("crops"), np.diag([1.0, -1, -1])
    of_camera = np.array([int(path.stem[0]) - 1 for path in crops.image_filenames])
    places = crops.cameras.camera_to_worlds[:, :, 3].numpy() @ y_up
    off = np.abs(places - truth["poses"][of_camera, :, 3]).max()
    file("crops/", name, "places of the cameras, metres", off, 1e-6)
    off = np.abs(crops.metadata["points3D_xyz"].numpy() @ y_up - truth["points"]).max()
    file("crops/", name, "points that splats start from, metres", off, 1e-6)


if __name__ == "__main__":
    name, files = sys.argv[1], Path(sys.argv[2])
    globals()[f"of_{name}"](files, dict(np.load(files / "truth.npz")))
    print(json.dumps(ROWS))
