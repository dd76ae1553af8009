from .dataset import load_dataset as load_dataset
from .errors import OmnistereoError as OmnistereoError
from .frame import Frame as Frame
from .frame import load_images as load_images
from .geometry.camera import OcamCamera as OcamCamera
from .geometry.pose import Pose as Pose
from .geometry.rig import Rig as Rig
from .geometry.sphere import SphereGrid as SphereGrid
from .rig_file import load_camera as load_camera
from .rig_file import load_rig as load_rig
from .rig_file import save_rig as save_rig
from .stereo.depth import Depth as Depth
from .stereo.depth import confidence as confidence
from .stereo.depth import winner_takes_all as winner_takes_all
from .stereo.mccnn import MCCNN as MCCNN
from .stereo.metrics import index_error as index_error
from .stereo.pipeline import estimate_depth as estimate_depth
from .stereo.sgm import sgm as sgm
from .stereo.sweep import SphereSweep as SphereSweep
from .stereo.sweepnet import SweepNet as SweepNet
from .stereo.volume import cost_volume as cost_volume
from .stereo.volumenet import VolumeNet as VolumeNet
from .stereo.zncc import ZNCC as ZNCC

__all__: list[str]
