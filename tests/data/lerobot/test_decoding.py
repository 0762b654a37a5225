"""Frames of videos, shrunk as they are decoded, against exact means of what libav decodes."""

import av
import cv2
import numpy as np
import pytest

from dpmacro.data.lerobot.decoding import Clip, decode_videos, scan_video

HEIGHT, WIDTH, COUNT = 48, 64, 6
TO_RGB = {  # ITU-R BT.601: weights of red and blue, brightness of black and white
    False: (0.299, 0.114, 16, 235),
    True: (0.299, 0.114, 0, 255),
}


def smooth(number):
    rng = np.random.default_rng(number)
    return cv2.resize(rng.integers(0, 255, (6, 8, 3), np.uint8), (WIDTH, HEIGHT))


def film(path, codec, pixels):
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=10, options={"crf": "18"} if codec == "h264" else {})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, pixels
        for number in range(COUNT):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(smooth(number), "rgb24")))
        container.mux(stream.encode(None))


def exact_rgb(frame):
    """RGB of every pixel by the definition, colours of a block of pixels being the same; not rounded."""
    red, blue, black, white = TO_RGB[frame.format.name.startswith("yuvj")]
    planes = [
        np.frombuffer(p, np.uint8).reshape(p.height, p.line_size)[:, : p.width].astype(float)
        for p in frame.planes
    ]
    y, u, v = (cv2.resize(p, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST) for p in planes)
    colours = 255 / (224 if black else 255)
    light = (y - black) * 255 / (white - black)
    b, r = light + 2 * (1 - blue) * (u - 128) * colours, light + 2 * (1 - red) * (v - 128) * colours
    return np.stack([r, (light - red * r - blue * b) / (1 - red - blue), b], axis=-1)


def decoded(path, size):
    film_ = scan_video(path)
    put = {}
    numbers = np.arange(len(film_.stamps))
    decode_videos(
        [Clip(film_, numbers, numbers)],
        lambda place, image, stored: put.update({place: (image, stored)}),
        lambda width, height: size,
    )
    return [put[number] for number in numbers]


KINDS = [("h264", "yuv420p"), ("h264", "yuv422p"), ("h264", "yuv444p"), ("mjpeg", "yuvj420p")]


@pytest.mark.parametrize("size", [(16, 12), (32, 24), (7, 24), (1, 1)])
@pytest.mark.parametrize(("codec", "pixels"), KINDS)
def test_frames_are_shrunk_to_exact_means(tmp_path, codec, pixels, size):
    film(tmp_path / "film.mp4", codec, pixels)
    with av.open(str(tmp_path / "film.mp4")) as container:
        frames = list(container.decode(video=0))
    assert {frame.format.name for frame in frames} == {pixels}
    off = []
    for frame, (image, stored) in zip(frames, decoded(tmp_path / "film.mp4", size), strict=True):
        assert image.shape == (size[1], size[0], 3) and image.dtype == np.uint8
        assert stored == (HEIGHT, WIDTH)
        exact = cv2.resize(exact_rgb(frame), size, interpolation=cv2.INTER_AREA)
        off.append(image - exact.clip(0, 255))
        full = cv2.resize(frame.to_ndarray(format="rgb24"), size, interpolation=cv2.INTER_AREA)
        assert np.abs(image.astype(int) - full).mean() < 3  # libav rounds down, twice
    assert np.abs(off).max() < 3 and np.abs(off).mean() < 0.8 and abs(np.mean(off)) < 0.6


@pytest.mark.parametrize("size", [(64, 48), (33, 12), (16, 25)])
def test_frames_that_are_not_halved_are_libavs(tmp_path, size):
    film(tmp_path / "film.mp4", "h264", "yuv420p")
    with av.open(str(tmp_path / "film.mp4")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    for frame, (image, stored) in zip(frames, decoded(tmp_path / "film.mp4", size), strict=True):
        assert stored is None and np.array_equal(image, frame)
