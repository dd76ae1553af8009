"""Sound: how late videos are, by one noise that all microphones hear, each with its own."""

from fractions import Fraction

import av
import numpy as np
import pytest
import scene
from scene import refused

from omnistereo_rigs.images.moments import SECOND
from omnistereo_rigs.images.sound import heard_late
from omnistereo_rigs.images.videos import open_videos
from omnistereo_tools.record.sync import measure_late

RATE, RNG = 16000, np.random.default_rng(0)
HEARD = RNG.normal(0, 0.2, 6 * RATE)


def film(path, pictures, sound, fps=10):
    """Write a video, Matroska with sound as it is."""
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4", rate=fps)
        video.height, video.width = pictures[0].shape
        audio = None if sound is None else container.add_stream("pcm_s16le", rate=RATE)
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="gray").reformat(format="yuv420p")
            frame.pts, frame.time_base = number, Fraction(1, fps)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
        if audio is not None:
            content = (sound.clip(-1, 1) * 32767).astype(np.int16)[None]
            samples = av.AudioFrame.from_ndarray(content, format="s16", layout="mono")
            samples.sample_rate, samples.pts, samples.time_base = RATE, 0, Fraction(1, RATE)
            container.mux(audio.encode(samples))
            container.mux(audio.encode(None))
    return path


def after(seconds, noise=0.1):
    """What a camera hears that begins so much later than the first."""
    own = HEARD[round(seconds * RATE) :][: 4 * RATE]
    return own + RNG.normal(0, noise, len(own))


def test_a_camera_that_began_later_is_early_by_its_times(tmp_path):
    still = [np.full((96, 96), 90, np.uint8)] * 30
    begins = (0.0, 0.35, 1.2)
    paths = [film(tmp_path / f"{k}.mkv", still, after(s)) for k, s in enumerate(begins)]
    late = heard_late([open_videos(path)[0] for path in paths])
    np.testing.assert_allclose(np.array(late) / SECOND, [-s for s in begins], atol=5e-4)


@pytest.mark.parametrize("sound", [None, np.zeros(4 * RATE), RNG.normal(0, 0.2, 4 * RATE)])
def test_another_sound_or_none_says_nothing(tmp_path, sound):
    still = [np.full((96, 96), 90, np.uint8)] * 30
    paths = [film(tmp_path / f"{k}.mkv", still, s) for k, s in enumerate([after(0), sound])]
    assert heard_late([open_videos(path)[0] for path in paths]) is None


def test_sync_takes_the_sound_where_the_images_show_nothing(tmp_path, capsys):
    rig = scene.rig(width=96, height=96)
    still = [np.full((96, 96), 90, np.uint8)] * 30
    begins = (0.0, 0.3, 0.0, 0.0)
    paths = [film(tmp_path / f"{k}.mkv", still, after(s)) for k, s in enumerate(begins)]
    late = measure_late(paths, rig, [])
    np.testing.assert_allclose(np.array(late) / SECOND, [-s for s in begins], atol=5e-4)
    assert "their sound does\ncamera 2 is 3 frames early (300 ms)" in capsys.readouterr().err
    paths[1] = film(tmp_path / "silent.mkv", still, None)
    with refused("or videos with the same sound"):
        measure_late(paths, rig, [])
