from .calibrate.checkerboard import Checkerboard
from .calibrate.joint import calibrate_rig
from .calibrate.single_camera import calibrate_camera
from .dataset import load_dataset
from .errors import OmnistereoError
from .frame import Frame, load_images
from .geometry.camera import OcamCamera, fit_inverse_polynomial
from .geometry.pose import Pose
from .geometry.rig import Rig, camera_pairs
from .geometry.sphere import SphereGrid
from .rig_files import load_camera, load_rig, save_rig
from .stereo.depth import Depth, confidence, winner_takes_all
from .stereo.learned import LearnedCost
from .stereo.mccnn import MCCNN
from .stereo.methods import Method
from .stereo.metrics import index_error, sparsification
from .stereo.pipeline import estimate_depth
from .stereo.sgm import sgm
from .stereo.sweep import SphereSweep
from .stereo.sweepnet import SweepNet
from .stereo.volume import cost_volume
from .stereo.volumenet import VolumeNet
from .stereo.zncc import ZNCC

__all__ = [
    "MCCNN",
    "ZNCC",
    "Checkerboard",
    "Depth",
    "Frame",
    "LearnedCost",
    "Method",
    "OcamCamera",
    "OmnistereoError",
    "Pose",
    "Rig",
    "SphereGrid",
    "SphereSweep",
    "SweepNet",
    "VolumeNet",
    "calibrate_camera",
    "calibrate_rig",
    "camera_pairs",
    "confidence",
    "cost_volume",
    "estimate_depth",
    "fit_inverse_polynomial",
    "index_error",
    "load_camera",
    "load_dataset",
    "load_images",
    "load_rig",
    "save_rig",
    "sgm",
    "sparsification",
    "winner_takes_all",
]
