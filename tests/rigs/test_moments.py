"""When pictures and frames were taken: names, packet stamps, stated beginnings."""

from fractions import Fraction

import av
import cv2
import numpy as np
import pytest
from scene import refused

from omnistereo_rigs.boards.captures import find_captures
from omnistereo_rigs.images.moments import SECOND, match_moments, read_names
from omnistereo_rigs.images.videos import moments_of_videos, open_videos

START = 1643807102_550000000
STEP = 150_000_000
TIMES = [START + k * STEP for k in range(12)]  # ns; the oracle


def name(pattern, time):
    """A name of a moment."""
    seconds, ns = divmod(time, SECOND)
    date = f"20220202_1305{seconds - 1643807100:02}"
    return pattern.format(s=seconds, ns=ns, ms=ns // 10**6, us=ns // 1000, t=time, date=date)


@pytest.mark.parametrize(
    "pattern",
    [
        "image_{s}_{ns:09}",
        "{s}_{ns}",
        "{s}.{ns}",
        "{s}-{us:06}",
        "{s}.{ms:03}",
        "{date}_{ms}",
        "IMG_{date}_{ms:03}",
        "PXL_{date}{ms:03}",
        "{t}",
    ],
)
def test_a_whole_stamp_is_read(pattern):
    """Shuffled by text, they come out in the order of time."""
    names = [name(pattern, time) for time in TIMES]
    ((moments, ordered),) = read_names([sorted(names)])
    assert ordered == names and np.diff(moments.times).tolist() == [STEP] * 11
    if "date" not in pattern:
        assert list(moments.times) == TIMES


@pytest.mark.parametrize(
    "names",
    [
        ["12-59-58", "12-59-59", "13-00-00"],
        ["cam 9.59.59", "cam 10.00.01"],
        ["23h59m59", "00h00m00", "00h00m01"],
        ["2024-05-01 at 12.59.59", "2024-05-01 at 13.00.00"],
    ],
)
def test_a_time_of_day_is_read_whole(names):
    ((moments, ordered),) = read_names([names[::-1]])
    assert ordered == names and min(np.diff(moments.times)) > 0


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["02-00-58", "02-00-59"], [58, 59]),
        (["01-02-59", "01-03-60"], [59, 60]),
        (["IMG_0001 (1)", "IMG_0002 (1)"], [1, 2]),
        (["IMG_20240501_123015 (1)", "IMG_20240501_123015 (2)"], [1, 2]),
        (["000007_cam2", "000008_cam2"], [7, 8]),
        (["20240501_123015_1", "20240501_123015_2"], [1, 2]),
        (["shot1.0001", "shot1.0002"], [1, 2]),
        (["v2.1_000", "v2.1_001"], [0, 1]),
    ],
)
def test_what_is_no_time_is_a_number(names, numbers):
    ((moments, _),) = read_names([names])
    assert moments.times is None and list(moments.numbers) == numbers


def test_of_several_numbers_those_in_common_count_and_are_told():
    a = [f"frame{k:04}_{7 * k + 3}" for k in range(5)]
    b = [f"frame{k:04}_{9 * k + 4}" for k in range(5)]
    first, second = (moments for moments, _ in read_names([a, b]))
    assert first.numbers == second.numbers == (0, 1, 2, 3, 4)
    assert second.read == "of names such as frame0004_40 the number 0004 is read"


def test_a_late_camera_is_matched_by_its_own_times():
    a, b = (moments for moments, _ in read_names([list(map(str, TIMES)), list(map(str, TIMES))]))
    pairs = match_moments([a, b], [0, 2 * STEP]).pairs
    assert pairs[1] == {TIMES[k]: TIMES[k + 2] for k in range(10)}


# --- Videos: each frame tells its own number by its gray value


def film(path, numbers, rate=10, begin=0, **metadata):
    """Write frames k at times k / rate, with B-frames, from `begin` on."""
    with av.open(str(path), "w") as container:
        container.metadata.update(metadata)
        stream = container.add_stream("mpeg4" if path.suffix != ".webm" else "libvpx", rate=rate)
        stream.width, stream.height, stream.bit_rate = 64, 64, 10**7
        stream.pix_fmt, stream.time_base = "yuv420p", Fraction(1, 1000)
        stream.codec_context.time_base = Fraction(1, 1000)
        stream.codec_context.max_b_frames = 2 if path.suffix != ".webm" else 0
        for k in numbers:
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), 6 * k, np.uint8), "rgb24")
            frame.pts, frame.time_base = 1000 * (k + begin) // rate, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def shown(paths):
    """For each moment that is matched, the numbers that the frames show."""
    videos = [video for path in paths for video in open_videos(path)]
    pairs = match_moments(moments_of_videos(videos)[0]).pairs
    common = sorted(set.intersection(*(set(own) for own in pairs)))
    grays = [
        [round(image.mean() / 6) for image in video.read([own[k] for k in common])]
        for video, own in zip(videos, pairs, strict=True)
    ]
    return list(zip(*grays, strict=True))


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "webm", "mov"])
def test_videos_that_drop_elsewhere_are_matched_by_their_stamps(tmp_path, suffix):
    early = [k for k in range(40) if not 10 <= k < 13]
    late = [k for k in range(40) if not 25 <= k < 29]
    paths = [film(tmp_path / f"{k}.{suffix}", n) for k, n in enumerate((early, late))]
    assert shown(paths) == [(k, k) for k in range(40) if k in early and k in late]


def test_a_time_code_states_when_a_video_begins(tmp_path):
    paths = [
        film(tmp_path / "a.mkv", range(16), timecode="10:00:00:00"),
        film(tmp_path / "b.mkv", range(4, 16), begin=-4, timecode="10:00:00:04"),
    ]
    assert shown(paths) == [(k, k) for k in range(4, 16)]
    words = moments_of_videos([open_videos(path)[0] for path in paths])[1]
    assert words == [
        f"by their time codes {paths[1]} begins 400 ms later than {paths[0]}: frames are matched "
        "by that"
    ]


def test_a_damaged_transport_stream_is_told(tmp_path):
    """What its decoder makes of lost packets looks like frames; the demuxer knows better."""
    path = tmp_path / "a.ts"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        for k in range(24):
            image = np.full((64, 64, 3), 6 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "rgb24")))
        container.mux(stream.encode(None))
    whole = path.read_bytes()
    assert moments_of_videos(open_videos(path))[1] == []
    path.write_bytes(whole[: len(whole) // 3] + whole[len(whole) // 2 :])
    assert "damaged packets" in moments_of_videos(open_videos(path))[1][0]


def test_beginnings_that_contradict_each_other_are_refused(tmp_path):
    made = "2024-05-01T10:00:00.{:06}Z"
    paths = [
        film(
            tmp_path / "a.mkv", range(8), timecode="10:00:00:00", creation_time=made.format(250000)
        ),
        film(
            tmp_path / "b.mkv", range(8), timecode="10:00:00:04", creation_time=made.format(950000)
        ),
    ]
    with refused(r"contradict.*time codes .* 400 ms.* 700 ms later"):
        moments_of_videos([open_videos(path)[0] for path in paths])


def test_chapters_of_one_recording_are_joined(tmp_path):
    film(tmp_path / "GH010042.MP4", range(8))
    film(tmp_path / "GH020042.MP4", range(8, 14), begin=-8)
    film(tmp_path / "GH010043.MP4", range(3))
    (video,) = open_videos(tmp_path / "GH010042.MP4")
    assert [round(image.mean() / 6) for image in video.read([0, 7, 8, 13])] == [0, 7, 8, 13]
    assert np.diff(video.stamps).tolist() == [SECOND // 10] * 13
    (tmp_path / "GH020042.MP4").rename(tmp_path / "GH030042.MP4")
    with refused("whose chapter 2 is missing"):
        open_videos(tmp_path / "GH010042.MP4")


def test_one_file_with_a_stream_for_each_lens(tmp_path):
    path = tmp_path / "dual.insv"
    with av.open(str(path), "w", format="mp4") as container:
        streams = [container.add_stream("mpeg4", rate=10) for _ in range(2)]
        for stream in streams:
            stream.width, stream.height, stream.bit_rate = 64, 64, 10**7
            stream.pix_fmt = "yuv420p"
        for k in range(6):
            for stream, more in zip(streams, (0, 20), strict=True):
                gray = np.full((64, 64, 3), 6 * (k + more), np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(gray, "rgb24")))
        for stream in streams:
            container.mux(stream.encode(None))
    assert shown([path]) == [(k, k + 20) for k in range(6)]


# --- Captures of a board


def picture(path, size=(30, 20)):
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.full(size[::-1], 100, np.uint8))


def test_captures_a_microsecond_apart_are_one(tmp_path):
    """At times that are no even rate; what only one camera has stays a capture."""
    for time in (0, 1, 4, 9, 10):
        picture(tmp_path / "cam1" / f"{START + time * STEP}.png")
    for time in (1, 4, 6, 10):
        picture(tmp_path / "cam2" / f"{START + time * STEP + 1200}.png")
    captures = find_captures(tmp_path)
    both = [all(row[k] for row in captures.paths) for k in range(len(captures.names))]
    assert both == [False, True, True, False, False, True]


def test_a_picture_of_another_size_is_left_out_by_majority(tmp_path):
    for k in range(4):
        picture(tmp_path / f"{k}.png", (15, 10) if k == 0 else (30, 20))
    with pytest.warns(UserWarning, match=r"0.png is left out: it is 15 × 10 px, 3 of 4 pictures"):
        images = find_captures(tmp_path).images(0)
    assert [image is not None for image in images] == [False, True, True, True]


def test_videos_of_a_board_give_sharp_and_varied_frames(tmp_path):
    """The second camera began three frames later; they are frames of one moment all the same."""
    film(tmp_path / "cam1.mkv", range(12), timecode="10:00:00:00")
    film(tmp_path / "cam2.mkv", range(3, 12), begin=-3, timecode="10:00:00:03")
    captures = find_captures(tmp_path)
    assert captures.cameras == ("cam1", "cam2") and captures.names[0] == "00003"
    assert captures.frames == (tuple(range(3, 12)), tuple(range(9)))
    one, other = captures.views()
    assert all(np.abs(a.astype(int) - b).mean() < 3 for a, b in zip(one, other, strict=True))
    for camera in ("cam1", "cam2"):
        film(tmp_path / f"{camera}.mkv", [7] * 1)
    assert len(find_captures(tmp_path).names) == 1
