"""How late videos are by their sound: what the microphone of one camera hears, the others hear."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omnistereo_rigs.images.moments import SECOND
from omnistereo_rigs.images.videos import Video

_RATE = 8000  # samples per second
_LISTENED_S = 60.0
_APART_S = 0.05  # of another peak; sound takes as long for 17 m
# Times the next peak: at most 1.31 of 150 pairs of independent noise, 16 and more where a fifth of
# the power is common.
_CLEAR = 1.5


def heard_late(videos: Sequence[Video]) -> list[int] | None:
    """Return by how much each video's times, from its first picture on, are late, ns, the first
    being on time; None if one of them has no sound, or they hear different things.
    """
    from scipy.signal import correlate  # half a second, which recordings without sound need not

    sounds = [_sound(video) for video in videos]
    late = list[int]()
    for sound in sounds:
        if sound is None or sounds[0] is None:
            return None
        (begin, first), (own_begin, own) = sounds[0], sound
        # the highest correlation over all shifts, and the next one elsewhere
        score = np.abs(correlate(own, first, method="fft"))
        peak = int(score.argmax())
        gap = round(_APART_S * _RATE)
        rival = max(score[: max(peak - gap, 0)].max(initial=0), score[peak + gap :].max(initial=0))
        if not score[peak] > _CLEAR * rival:
            return None
        late.append(round((own_begin - begin + (peak - len(first) + 1) / _RATE) * SECOND))
    return late


def _sound(video: Video) -> tuple[float, NDArray[np.float32]] | None:
    """Return the begin of the sound, s after the first picture, and its changes; or None."""
    import av

    with av.open(str(video.path)) as container:
        if not container.streams.audio:
            return None
        resampler = av.AudioResampler(format="flt", layout="mono", rate=_RATE)
        begin, parts = np.nan, [np.zeros(1, np.float32)]
        for frame in container.decode(audio=0):
            time = frame.time or 0.0
            begin = time if np.isnan(begin) else begin
            if time - begin > _LISTENED_S:
                break
            parts += [part.to_ndarray()[0] for part in resampler.resample(frame)]
    changes = np.diff(np.concatenate(parts))  # hum and wind are slow
    return (begin - video.stamps[0] / SECOND, changes) if changes.any() else None
