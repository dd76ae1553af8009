from .boards.checkerboard import Checkerboard as Checkerboard
from .boards.joint import calibrate_rig as calibrate_rig
from .boards.single_camera import calibrate_camera as calibrate_camera
from .doctor.rig_check import check_rig as check_rig
from .formats.read import read_any_rig as read_any_rig
from .images.from_images import measure_rig as measure_rig

__all__: list[str]
