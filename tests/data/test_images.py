"""Images held as asked: shrunk, of one size, within the memory there is."""

import cv2
import numpy as np
import pytest

from dpmacro.data.images import DatasetError, FrameBuffer, ImageTransform


def noise(height, width):
    return np.random.default_rng(height).integers(0, 256, (height, width, 3), np.uint8)


def test_images_come_to_their_places_shrunk():
    buffer, images = FrameBuffer(3, ImageTransform((8, 6)), "here"), [noise(48, 64) for _ in range(3)]
    for place in (2, 0, 1):
        buffer.put(place, images[place])
    assert buffer.stored_shape == (48, 64)
    wanted = [cv2.resize(image, (8, 6), interpolation=cv2.INTER_AREA) for image in images]
    assert np.array_equal(buffer.images, wanted)


def test_images_of_the_size_asked_for_are_as_stored():
    buffer = FrameBuffer(1, ImageTransform((64, 48)), "here")
    buffer.put(0, noise(48, 64))
    assert buffer.stored_shape is None and np.array_equal(buffer.images[0], noise(48, 64))


@pytest.mark.parametrize("transform", [ImageTransform(), ImageTransform((8, 6))])
def test_images_of_several_sizes_are_refused(transform):
    buffer = FrameBuffer(2, transform, "here")
    buffer.put(1, noise(48, 64))
    with pytest.raises(DatasetError, match=r"here: frame 0 is \(24, 32, 3\), others \(48, 64, 3\)"):
        buffer.put(0, noise(24, 32))


@pytest.mark.parametrize(
    ("transform", "message"),
    [
        (ImageTransform((65, 48)), "here: images are 64x48, image_size is 65x48: ask for smaller ones"),
        (ImageTransform((8, 6), stored=(32, 24)), "here: images are 64x48, the policy was trained on 32x24"),
        (
            ImageTransform(memory=1.0),
            "here: 200000 images of 64x48 take 1.7 GiB, and there are 1 for them: give more "
            r"--planner.memory_limit, shrink them, like --dataset.image_size='\[32,24\]', or take fewer",
        ),
    ],
)
def test_what_cannot_be_held_is_named(transform, message):
    with pytest.raises(DatasetError, match=message):
        FrameBuffer(200_000, transform, "here").put(0, noise(48, 64))
