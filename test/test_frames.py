"""Poses in a frame that the user names. tf2_ros is not on PyPI: a stand-in with its calls answers here."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.types import Array
from elevator_rectify.ros.frames import Frames, Transform
from elevator_rectify.ros.poses import quaternion, rotation_of
from test.messages import header

R_MAP_CAMERA = rotation(np.array([0.3, -1.2, 0.5]))
T_MAP_CAMERA = np.array([1.0, -2.0, 0.5])


class _Unknown(Exception):
    pass


class _Buffer:
    """Knows the way from the frame `camera` to the frame `map`, from one second on."""

    def lookup_transform(self, target: str, source: str, time: Any) -> Any:
        if (target, source) != ("map", "camera"):
            raise _Unknown(f'"{target}" passed to lookupTransform does not exist')
        if time.nanoseconds < 10**9:
            raise _Unknown("extrapolation into the past")
        (x, y, z), (i, j, k, w) = T_MAP_CAMERA, quaternion(R_MAP_CAMERA)
        turn = SimpleNamespace(x=i, y=j, z=k, w=w)
        return SimpleNamespace(transform=SimpleNamespace(translation=SimpleNamespace(x=x, y=y, z=z), rotation=turn))


@pytest.fixture
def frames(monkeypatch: pytest.MonkeyPatch) -> Frames:
    listener = SimpleNamespace(Buffer=_Buffer, TransformListener=lambda *_: None, TransformException=_Unknown)
    monkeypatch.setitem(sys.modules, "tf2_ros", listener)
    return Frames(None)


def test_the_cameras_own_frame_needs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    alone = Frames(None)
    for name in ("", "camera"):
        found = alone.at(name, header(0))
        assert isinstance(found, Transform) and found.name == "camera"
        np.testing.assert_array_equal(found.R, np.eye(3))
    assert "needs tf2_ros" in str(alone.at("map", header(0)))


def test_another_frame_is_looked_up_at_the_images_time(frames: Frames) -> None:
    found = frames.at("map", header(2 * 10**9))
    assert isinstance(found, Transform) and found.name == "map"
    np.testing.assert_allclose(found.R, R_MAP_CAMERA, atol=1e-12)
    np.testing.assert_array_equal(found.t, T_MAP_CAMERA)
    assert "extrapolation" in str(frames.at("map", header(0)))
    assert "frame_id odom" in str(frames.at("odom", header(2 * 10**9)))


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
