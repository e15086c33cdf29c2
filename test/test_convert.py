import array
from typing import Any

import cv2
import numpy as np
import pytest

from elevator_rectify.core.motion import rotation
from elevator_rectify.ros.convert import BadMessage, camera_from_message, detections_from_message, image_from_message
from elevator_rectify.ros.messages import make_ros
from elevator_rectify.ros.output import quaternion
from test.messages import camera_info, detections, header, image

PICTURE = np.random.default_rng(0).integers(0, 255, (6, 10, 3), dtype=np.uint8)


def raw(encoding: str, picture: Any, padding: int = 0) -> Any:
    message = image(0, picture)
    rows = np.pad(picture.reshape(picture.shape[0], -1), ((0, 0), (0, padding)), constant_values=7)
    message.encoding, message.step, message.data = encoding, rows.shape[1], array.array("B", rows.tobytes())
    return message


@pytest.mark.parametrize("padding", [0, 5])
def test_encodings_and_padded_rows(padding: int) -> None:
    np.testing.assert_array_equal(image_from_message(raw("bgr8", PICTURE, padding)), PICTURE)
    np.testing.assert_array_equal(image_from_message(raw("rgb8", PICTURE, padding)), PICTURE[..., ::-1])
    np.testing.assert_array_equal(image_from_message(raw("mono8", PICTURE[..., 0].copy(), padding)), PICTURE[..., 0])


def test_compressed_pictures() -> None:
    data = cv2.imencode(".png", PICTURE)[1].ravel()
    message = make_ros("sensor_msgs/msg/CompressedImage", header=header(0), format="png", data=data)
    np.testing.assert_array_equal(image_from_message(message), PICTURE)
    message.data = array.array("B", data.tobytes()[:40])
    with pytest.raises(BadMessage, match="data"):
        image_from_message(message)
    message.data = array.array("B")
    with pytest.raises(BadMessage, match="0 bytes"):
        image_from_message(message)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("encoding", "yuv9", "encoding = yuv9"),
        ("step", 3, "step = 3"),
        ("height", 600, "data = 180 bytes"),
        ("width", 0, "0 x 6"),
    ],
)
def test_bad_images_are_refused_by_topic_field_and_value(field: str, value: object, words: str) -> None:
    message = raw("bgr8", PICTURE)
    setattr(message, field, value)
    with pytest.raises(BadMessage, match="/cam/image") as caught:
        image_from_message(message, "/cam/image")
    assert words in str(caught.value)


def test_camera_info() -> None:
    camera = camera_from_message(camera_info())
    assert (camera.width, camera.height, camera.focal_px) == (640, 480, 320.0)
    message = camera_info()
    message.k = np.zeros(9)
    with pytest.raises(BadMessage, match="uncalibrated"):
        camera_from_message(message)
    message = camera_info()
    message.binning_x = 2
    with pytest.raises(BadMessage, match="binning"):
        camera_from_message(message)


def test_pose_array() -> None:
    found = detections_from_message(detections(0, np.array([[1.5, 2.5], [np.nan, 3.0]])))
    assert (found[0].x_px, found[0].y_px) == (1.5, 2.5) and np.isnan(found[1].x_px)


@pytest.mark.parametrize("vector", [[0, 0, 0], [0, 0, 3.1], [0.3, -0.2, 0.9], [-3.14159, 0, 0], [1e-9, 0, 0]])
def test_quaternion_equals_the_rotation(vector: list[float]) -> None:
    x, y, z, w = quaternion(rotation(np.array(vector)))
    half = np.array([x, y, z])
    assert np.linalg.norm([x, y, z, w]) == pytest.approx(1.0)
    point = np.array([0.3, -0.5, 0.8])
    turned = point + 2 * np.cross(half, np.cross(half, point) + w * point)
    np.testing.assert_allclose(turned, rotation(np.array(vector)) @ point, atol=1e-9)
