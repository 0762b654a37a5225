"""MP4 files whose tables say more than they hold: refused in a line, before libav takes memory for it."""

import struct

import av
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lerobot_files import film

from dpmacro.data.images import DatasetError
from dpmacro.data.lerobot.boxes import check_tables
from dpmacro.data.lerobot.decoding import Clip, decode_videos, probe_video, scan_video
from tests.fuzz.limits import limited

COUNT = 11
CODECS = {"libx264": {}, "libsvtav1": {"g": "2", "crf": "30", "preset": "12", "svtav1-params": "lp=1"}}
HUGE = 0x7FFFFFFF


@pytest.fixture(scope="module", params=CODECS)
def content(request, tmp_path_factory):
    """The bytes of a small film, as LeRobot encodes one."""
    path = tmp_path_factory.mktemp("films") / "film.mp4"
    film(path, COUNT, 10, request.param, options=CODECS[request.param])
    return path.read_bytes()


def changed(content, name, offset, value, wide=4):
    """The file with another number so many bytes after a box's name."""
    place = content.index(name) + 4 + offset
    return content[:place] + value.to_bytes(wide, "big") + content[place + wide :]


def read(path):
    """All frames, as datasets are read; how many there were."""
    stored, listed = probe_video(path), scan_video(path)
    numbers, seen = np.arange(min(len(listed.stamps), 100)), []

    def sized(width, height):
        if (width, height) != (stored.width, stored.height):
            raise DatasetError(f"{path}: of several sizes")
        return width, height

    decode_videos(Clip(listed, numbers, numbers).runs(), lambda place, *given: seen.append(place), sized)
    return len(seen)


def test_a_sound_film_is_read(content, tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(content)
    check_tables(path)
    assert read(path) == COUNT


@pytest.mark.parametrize(
    ("name", "offset", "value", "message"),
    [
        (b"stts", 8, HUGE, "its table stts says that there are 2147483647 frames"),
        (b"stts", 4, 5000, "its table stts says that it has 5000 rows"),
        (b"stsz", 4, 1, "is read"),  # as many frames as before, of a byte each
        (b"stsz", 8, HUGE, "its table stsz says that it has 2147483647 rows"),
        (b"stsc", 4, HUGE, "its table stsc says that it has 2147483647 rows"),
        (b"stco", 4, HUGE, "its table stco says that it has 2147483647 rows"),
        (b"elst", 4, HUGE, "its table elst says that it has 2147483647 rows"),
        (b"stsd", -8, HUGE, "its part 'stsd' is larger than what holds it"),
        (b"trak", -8, HUGE, "its part 'trak' is larger than what holds it"),
        (b"moov", -8, HUGE, "ends within its part 'moov'"),
    ],
)
def test_tables_that_say_too_much(content, tmp_path, name, offset, value, message):
    path = tmp_path / "film.mp4"
    path.write_bytes(changed(content, name, offset, value))
    with limited():
        if message == "is read":
            check_tables(path)
            return
        for use in (check_tables, probe_video, scan_video):
            with pytest.raises(DatasetError) as error:
                use(path)
            told = str(error.value)
            assert told.startswith(f"{path}: {message}") and told.endswith("; record the dataset again")


def test_frames_of_one_size_are_counted_by_it(content, tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(changed(changed(content, b"stsz", 4, 100), b"stsz", 8, HUGE))
    with pytest.raises(DatasetError, match="stsz says that there are 2147483647 frames of 100 bytes"):
        check_tables(path)


@pytest.mark.parametrize(("flags", "message"), [(0, "2147483647 frames"), (0x300, "5000 rows")])
def test_fragments(tmp_path, flags, message):
    path, count = tmp_path / "film.mp4", HUGE if flags == 0 else 5000
    table = struct.pack(">I4sII", 16, b"trun", flags, count)
    inner = struct.pack(">I4s", 8 + len(table), b"traf") + table
    outer = struct.pack(">I4s", 8 + len(inner), b"moof") + inner
    path.write_bytes(outer + struct.pack(">I4sQ", 1, b"mdat", 20_000) + bytes(19_984))
    with pytest.raises(DatasetError, match=f"its table trun says that .* {message}"):
        check_tables(path)


@pytest.mark.parametrize("other", [b"", b"abc", b"\x1aE\xdf\xa3" + bytes(100), bytes(1000), b"\xff" * 1000])
def test_other_files_pass(tmp_path, other):
    (tmp_path / "film.mp4").write_bytes(other)
    check_tables(tmp_path / "film.mp4")


@pytest.mark.parametrize("codec", ["mpeg4", "libx264"])
def test_a_large_frame_in_a_small_file_is_refused(tmp_path, codec):
    """A decoder may keep 17 of them."""
    path = tmp_path / "film.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=10)
        stream.width, stream.height, stream.pix_fmt = 4096, 2176, "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.zeros((2176, 4096, 3), np.uint8), "rgb24")
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    told = r"is (4096x2176|0x0); of a file of its size 1 to 8388608 pixels are read"
    with limited(), pytest.raises(DatasetError, match=told):
        probe_video(path)
    path.write_bytes(path.read_bytes() + bytes(2**20))
    assert probe_video(path).width == 4096


damage = st.lists(
    st.tuples(
        st.sampled_from([b"stts", b"stsz", b"stsc", b"stco", b"elst", b"stsd", b"mdhd", b"moov", b"mdat"]),
        st.integers(-4, 100),
        st.sampled_from([HUGE, 2**24, 0x10000000, 2**32 - 1]) | st.integers(0, 2**32 - 1),
        st.sampled_from([1, 2, 4]),
    ),
    min_size=1,
    max_size=3,
)


@settings(
    max_examples=40,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(damage)
def test_damaged_heads_are_read_or_refused_within_a_gibibyte(content, tmp_path, edits):
    path, changes = tmp_path / "film.mp4", content
    for name, offset, value, wide in edits:
        if name in changes:
            changes = changed(changes, name, offset, value % 256**wide, wide)
    path.write_bytes(changes)
    with limited():
        try:
            read(path)
        except DatasetError as error:
            told = str(error)
            assert str(path) in told and "\n" not in told and "memory" not in told, told
