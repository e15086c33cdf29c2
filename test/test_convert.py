import array
from dataclasses import replace
from types import SimpleNamespace as Flat
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elevator_rectify.core import Detection
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.render.bag import header_message as make_bag_header
from elevator_rectify.ros.bag import make_bag_message
from elevator_rectify.ros.config import DetectionsConfig
from elevator_rectify.ros.convert import camera_from_message, detections_from_message
from elevator_rectify.ros.detections import boxes_message
from elevator_rectify.ros.messages import make_ros
from elevator_rectify.ros.pictures import (
    ENCODINGS,
    BadMessage,
    announced_size,
    check_image,
    depth_from_message,
    image_from_message,
)
from elevator_rectify.ros.poses import quaternion
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


@pytest.mark.parametrize("big_endian", [0, 1])
@pytest.mark.parametrize("encoding", ["mono16", "bgr16", "rgb16"])
def test_of_sixteen_bits_the_upper_ones_are_kept(encoding: str, big_endian: int) -> None:
    grey = encoding == "mono16"
    values = (PICTURE[..., 0] if grey else PICTURE).astype(np.uint16) * 256 + 77
    message = raw(encoding, values.astype(">u2" if big_endian else "<u2").view(np.uint8), 4)
    message.width, message.is_bigendian = PICTURE.shape[1], big_endian
    expected = {"mono16": PICTURE[..., 0], "bgr16": PICTURE, "rgb16": PICTURE[..., ::-1]}[encoding]
    np.testing.assert_array_equal(image_from_message(message), expected)


def test_alpha_is_dropped() -> None:
    alpha = np.dstack([PICTURE, np.full(PICTURE.shape[:2], 9, np.uint8)])
    np.testing.assert_array_equal(image_from_message(raw("bgra8", alpha)), PICTURE)
    np.testing.assert_array_equal(image_from_message(raw("rgba8", alpha[..., [2, 1, 0, 3]])), PICTURE)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_show_the_colour_that_was_sampled(pattern: str, bits: int) -> None:
    """An even colour, sampled by the pattern's letters row by row, comes back everywhere."""
    colour = {"b": 40, "g": 90, "r": 200}
    mosaic = np.tile(np.array([colour[c] for c in pattern], np.uint8).reshape(2, 2), (4, 5))
    samples = (mosaic.astype("<u2") << 8).view(np.uint8) if bits == 16 else mosaic
    message = raw(f"bayer_{pattern}{bits}", samples)
    message.width = mosaic.shape[1]
    np.testing.assert_array_equal(image_from_message(message), np.full((8, 10, 3), [40, 90, 200], np.uint8))


@pytest.mark.parametrize(("encoding", "order"), [("yuv422", "uyvy"), ("uyvy", "uyvy"), ("yuv422_yuy2", "yuyv")])
def test_both_byte_orders_of_yuv(encoding: str, order: str) -> None:
    colour = np.full((2, 4, 3), [30, 160, 220], np.uint8)
    y = int(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)[0, 0])
    # Video range: luma 16 to 235, chroma 16 to 240.
    sample = {
        "y": round(16 + y * 219 / 255),
        "u": round(128 + 0.564 * (30 - y) * 224 / 255),
        "v": round(128 + 0.713 * (220 - y) * 224 / 255),
    }
    data = np.tile(np.array([sample[c] for c in order], np.uint8), (2, 2)).reshape(2, 8)
    message = raw(encoding, data)
    message.width = 4
    # Rounding of three samples and the conversion's constants.
    np.testing.assert_allclose(image_from_message(message).astype(int), colour.astype(int), atol=6)
    message.width = 3
    with pytest.raises(BadMessage, match="cannot hold"):
        image_from_message(message)


def test_depth_images() -> None:
    millimetres = np.array([[0, 500], [65535, 1234]], np.uint16)
    message = raw("16UC1", millimetres.view(np.uint8).reshape(2, 4))
    message.width = 2
    np.testing.assert_allclose(depth_from_message(message), [[np.nan, 0.5], [65.535, 1.234]])
    metres = np.array([[np.nan, 0.5], [-1.0, np.inf]], ">f4")
    message = raw("32FC1", metres.view(np.uint8).reshape(2, 8))
    message.width, message.is_bigendian = 2, 1
    np.testing.assert_allclose(depth_from_message(message), [[np.nan, 0.5], [np.nan, np.nan]])
    with pytest.raises(BadMessage, match="depth: encoding = bgr8"):
        depth_from_message(raw("bgr8", PICTURE))


@settings(max_examples=300, deadline=None)
@given(
    encoding=st.sampled_from([*ENCODINGS, "16UC1", "32FC1", "", "mono8 "]),
    width=st.integers(0, 9),
    height=st.integers(0, 9),
    step=st.integers(0, 60),
    big_endian=st.integers(0, 1),
    data=st.binary(max_size=300),
)
def test_any_image_is_converted_or_refused(
    encoding: str, width: int, height: int, step: int, big_endian: int, data: bytes
) -> None:
    message = make_ros("sensor_msgs/msg/Image", header=header(0), height=height, width=width, encoding=encoding)
    message.step, message.is_bigendian, message.data = step, big_endian, array.array("B", data)
    for convert in (image_from_message, depth_from_message, check_image):
        try:
            convert(message)
        except BadMessage as error:
            assert len(str(error)) < 700
            continue
        assert width > 0 and height > 0 and step * height <= len(data)


@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_cameras_of_ten_or_twelve_bits_can_be_seen(encoding: str, bits: int) -> None:
    ramp = np.arange(0, 1 << bits, 1 << (bits - 8), dtype="<u2").reshape(8, 32)
    message = raw(encoding, ramp.view(np.uint8))
    message.width = 32
    np.testing.assert_array_equal(image_from_message(message).ravel(), np.arange(256))


@pytest.mark.parametrize("encoding", ["nv12", "nv21"])
def test_colours_in_a_plane_of_their_own(encoding: str) -> None:
    colour = np.full((4, 6, 3), [30, 160, 220], np.uint8)
    planar = cv2.cvtColor(colour, cv2.COLOR_BGR2YUV_I420)
    u, v = planar[4:].reshape(2, -1)
    pairs = np.stack([u, v] if encoding == "nv12" else [v, u], axis=-1).reshape(2, 6)
    message = raw(encoding, np.vstack([planar[:4], pairs]), 2)
    message.height, message.width = 4, 6
    # Rounding of three samples and the conversion's constants.
    np.testing.assert_allclose(image_from_message(message).astype(int), colour.astype(int), atol=6)
    assert check_image(message) == (4, 6)
    message.data = message.data[:-1]
    with pytest.raises(BadMessage, match="shorter"):
        check_image(message)


def test_four_channels_of_any_name_and_depth() -> None:
    alpha = np.dstack([PICTURE, np.full(PICTURE.shape[:2], 9, np.uint8)])
    np.testing.assert_array_equal(image_from_message(raw("8UC4", alpha)), PICTURE)
    deep = raw("rgba16", np.ascontiguousarray(alpha[..., [2, 1, 0, 3]].astype("<u2") << 8).view(np.uint8))
    deep.width = PICTURE.shape[1]
    np.testing.assert_array_equal(image_from_message(deep), PICTURE)


def test_text_of_messages_cannot_steer_a_terminal() -> None:
    message = raw("bgr8\x1b[2J\n" + "x" * 500, PICTURE)
    with pytest.raises(BadMessage) as caught:
        image_from_message(message)
    text = str(caught.value)
    assert text.isprintable() and "\\x1b" in text and "x" * 150 not in text


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_a_picture_that_would_be_too_large_is_not_decoded(ending: str) -> None:
    data = cv2.imencode(ending, np.zeros((3000, 4000), np.uint8))[1].tobytes()
    assert announced_size(data) == (4000, 3000)
    message = make_ros("sensor_msgs/msg/CompressedImage", header=header(0), format=ending)
    message.data = array.array("B", data)
    assert image_from_message(message).shape == (3000, 4000)
    with pytest.raises(BadMessage, match=r"4000 x 3000 is more than 11\.9 megapixels"):
        image_from_message(message, max_pixels=11_900_000)


@given(data=st.binary(max_size=64))
def test_any_header_of_a_picture_is_read_or_not(data: bytes) -> None:
    for start in (b"", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"):
        size = announced_size(start + data)
        assert size is None or min(size) >= 0


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
    message.roi.width = 641
    with pytest.raises(BadMessage, match="roi"):
        camera_from_message(message)


def test_a_binned_region_sees_the_same_rays() -> None:
    """A pixel of the region, in the full image's coordinates, has the same ray (REP-104)."""
    message = camera_info()
    message.d, message.distortion_model = [-0.1, 0.02, 0.0, 0.0, 0.0], "plumb_bob"
    full = camera_from_message(message)
    message.roi.x_offset, message.roi.y_offset, message.roi.width, message.roi.height = 100, 60, 400, 300
    message.binning_x = message.binning_y = 2
    binned = camera_from_message(message)
    assert (binned.width, binned.height) == (200, 150)
    inside, corner = np.array([[10.0, 20.0], [150.0, 100.0]]), np.array([100.0, 60.0])
    np.testing.assert_allclose(binned.rays(inside), full.rays(2 * inside + corner), atol=1e-9)


def test_a_rectified_image_is_seen_by_the_projection_matrix() -> None:
    message = camera_info()
    message.d = [-0.3, 0.1, 0.0, 0.0, 0.0]
    message.p = np.array([250.0, 0, 300, 0, 0, 260, 220, 0, 0, 0, 1, 0])
    camera = camera_from_message(message, rectified=True)
    assert not camera.distorted and camera.matrix[0, 0] == 250.0 and camera.matrix[1, 2] == 220.0
    message.p = np.zeros(12)
    with pytest.raises(BadMessage, match="p = "):
        camera_from_message(message, rectified=True)


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


@pytest.mark.parametrize(
    ("field", "K"),
    [
        ("principal point", [320, 0, 0, 0, 320, 0, 0, 0, 1]),
        ("principal point", [640, 0, 640, 0, 640, 480, 0, 0, 1]),
        ("focal lengths", [20, 0, 320, 0, 20, 240, 0, 0, 1]),
        ("focal lengths", [5000, 0, 320, 0, 5000, 240, 0, 0, 1]),
    ],
)
def test_intrinsics_of_another_resolution_are_refused(field: str, K: list[float]) -> None:
    message = camera_info()
    message.k = [float(v) for v in K]
    with pytest.raises(BadMessage, match=f"camera_info: k: {field}"):
        camera_from_message(message)


def test_the_field_that_is_wrong_is_named() -> None:
    message = camera_info()
    message.d, message.distortion_model = [0.1] * 7, "plumb_bob"
    with pytest.raises(BadMessage, match="camera_info: distortion_model = 'plumb_bob'"):
        camera_from_message(message)
    message = camera_info()
    message.width = 0
    with pytest.raises(BadMessage, match="width x height"):
        camera_from_message(message)


def test_classes_that_are_no_buttons_are_left_out_and_unread_ones_have_no_label() -> None:
    names = ["B2", "led", "Keyhole", "bt_keyhole", "text_open", "speaker", "unknown", "blur", "B1", "7", "open"]
    given_ = [Detection(float(k), 1.0, 9.0, 9.0, name, 0.9) for k, name in enumerate(names)]
    message = boxes_message(given_, make_bag_header(0, "camera"), make_bag_message)
    found = detections_from_message(message)
    assert [d.label for d in found] == ["B2", "", "", "B1", "", "open"]
    assert [d.x_px for d in found] == [0.0, 6.0, 7.0, 8.0, 9.0, 10.0]
    kept = detections_from_message(message, DetectionsConfig(ignore=""))
    assert len(kept) == len(names)
    mapped = detections_from_message(message, DetectionsConfig(labels="7=led, led=8", ignore=" LED "))
    assert [d.x_px for d in mapped if d.label == "8"] == [1.0] and 9.0 not in [d.x_px for d in mapped]


def test_several_hypotheses_are_a_distribution_where_their_scores_can_be_one() -> None:
    message = boxes_message([Detection(1.0, 1.0, 9.0, 9.0, "B1", 0.6)], make_bag_header(0, "camera"), make_bag_message)
    (item,) = message.detections
    second = make_bag_message("vision_msgs/msg/ObjectHypothesis", class_id="B7", score=0.3)
    results = [*item.results, replace(item.results[0], hypothesis=second)]
    several = replace(message, detections=[replace(item, results=results)])
    (found,) = detections_from_message(several)
    assert found.label == "B1" and found.readings == (("B1", 0.6), ("B7", 0.3))
    config = DetectionsConfig(image_width_px=320, image_height_px=240, offset_x_px=4.0, offset_y_px=-8.0)
    (moved,) = detections_from_message(several, config, (640, 480))
    (plain,) = detections_from_message(several, DetectionsConfig(), (640, 480))
    assert (moved.x_px, moved.y_px) == (2.0 * (plain.x_px - 4.0), 2.0 * (plain.y_px + 8.0))
    assert (moved.width_px, moved.height_px) == (2.0 * plain.width_px, 2.0 * plain.height_px)
    (resized,) = detections_from_message(several, DetectionsConfig(image_width_px=320), (640, 480))
    assert resized.x_px == 2.0 and resized.readings == found.readings
    second = replace(second, score=0.9)
    results = [*item.results, replace(item.results[0], hypothesis=second)]
    (found,) = detections_from_message(replace(message, detections=[replace(item, results=results)]))
    assert found.label == "B7" and found.readings == ()


def test_boxes_of_foxys_vision_msgs_are_read() -> None:
    centre, result = Flat(x=40.0, y=30.0, theta=0.0), Flat(id="open", score=0.8)
    item = Flat(bbox=Flat(center=centre, size_x=9.0, size_y=8.0), results=[result])
    assert detections_from_message(Flat(detections=[item])) == [Detection(40.0, 30.0, 9.0, 8.0, "open", 0.8)]
