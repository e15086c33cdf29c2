"""Poses in a frame that the user names. tf2_ros is not on PyPI: a stand-in with its calls answers here."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.types import Array
from elevator_rectify.ros import frames as frames_module
from elevator_rectify.ros.frames import Frames, Transform
from elevator_rectify.ros.poses import quaternion, rotation_of
from elevator_rectify.ros.serialized import Header, Stamp
from test.messages import header
from test.stand_ins import tf2_ros

R_MAP_CAMERA = rotation_of(*tf2_ros.QUATERNION)
T_MAP_CAMERA = np.array(tf2_ros.TRANSLATION)


@pytest.fixture
def frames(monkeypatch: pytest.MonkeyPatch) -> Frames:
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2_ros)
    return Frames(None)


def test_the_cameras_own_frame_needs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    alone = Frames(None)
    for name in ("", "camera"):
        found = alone.at(name, header(0))
        assert isinstance(found, Transform) and found.name == "camera"
        np.testing.assert_array_equal(found.R, np.eye(3))
    assert "needs tf2_ros" in str(alone.at("map", header(0)))


# Images are read from their bytes: their header is none of rclpy's.
@pytest.mark.parametrize("of_image", [header(2 * 10**9), Header(Stamp(2, 0), "camera")])
def test_another_frame_is_looked_up_at_the_images_time(frames: Frames, of_image: Header) -> None:
    found = frames.at("map", of_image)
    assert isinstance(found, Transform) and found.name == "map"
    np.testing.assert_allclose(found.R, R_MAP_CAMERA, atol=1e-12)
    np.testing.assert_array_equal(found.t, T_MAP_CAMERA)
    assert "extrapolation" in str(frames.at("map", header(0)))
    assert "frame_id odom" in str(frames.at("odom", of_image))


def test_only_what_may_still_come_is_waited_for(frames: Frames) -> None:
    """The transform of a moving frame comes a little after the image; a frame that does not exist never comes."""
    for name, stamp in (("map", 2 * 10**9), ("odom", 2 * 10**9), ("map", 0)):
        frames.at(name, header(stamp))
    assert [waited > 0 for waited in frames._buffer.waited_ns] == [False, False, False, True]


def test_what_is_known_of_frames_comes_in_a_moment(frames: Frames, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not frames.filling
    frames.at("map", header(0))
    assert frames.filling
    began = frames_module.time.monotonic()
    monkeypatch.setattr(frames_module.time, "monotonic", lambda: began + 2.0)
    assert not frames.filling


def test_a_covariance_turns_with_the_frame() -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6))
    there = Transform("map", R_MAP_CAMERA, T_MAP_CAMERA).covariance(A @ A.T)
    # What a sample of errors shows: each turned, then their covariance.
    errors: Array = rng.normal(size=(6, 6)) @ A.T
    turned = np.concatenate([errors[:, :3] @ R_MAP_CAMERA.T, errors[:, 3:] @ R_MAP_CAMERA.T], axis=1)
    products: Array = errors.T @ errors
    sample = Transform("map", R_MAP_CAMERA, T_MAP_CAMERA).covariance(products)
    np.testing.assert_allclose(sample, turned.T @ turned, atol=1e-9)
    np.testing.assert_allclose(np.linalg.eigvalsh(there), np.linalg.eigvalsh(A @ A.T), atol=1e-9)


@pytest.mark.parametrize("vector", [[0.0, 0.0, 0.0], [0.4, -0.2, 2.0], [3.1, 0.0, 0.1]])
def test_a_quaternion_gives_its_rotation_back(vector: list[float]) -> None:
    R = rotation(np.array(vector))
    np.testing.assert_allclose(rotation_of(*quaternion(R)), R, atol=1e-12)
