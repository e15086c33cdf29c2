from elevator_rectify.ros.config import PairingConfig
from elevator_rectify.ros.pairing import Pairing
from test.messages import camera_info, detections, image


def test_late_detections_find_their_image() -> None:
    pairing = Pairing(PairingConfig())
    pairing.add_camera_info(camera_info(1))
    for stamp in (1, 2, 3):
        assert pairing.add_image(image(stamp)) == []
    (frame,) = pairing.add_detections(detections(2))
    assert frame.image.header.stamp.nanosec == frame.detections.header.stamp.nanosec == 2


def test_detections_may_come_first_and_the_camera_info_last() -> None:
    pairing = Pairing(PairingConfig())
    assert pairing.add_detections(detections(5)) == [] and pairing.add_image(image(5)) == []
    assert pairing.waiting()["image waiting for camera_info"] == 1
    assert len(pairing.add_camera_info(camera_info(9))) == 1
    assert not pairing.waiting()


def test_camera_info_of_the_same_stamp_is_preferred_to_the_newest() -> None:
    pairing = Pairing(PairingConfig())
    for stamp in (1, 2):
        pairing.add_camera_info(camera_info(stamp))
    pairing.add_image(image(1))
    (frame,) = pairing.add_detections(detections(1))
    assert frame.camera_info.header.stamp.nanosec == 1
    pairing.add_image(image(7))
    (frame,) = pairing.add_detections(detections(7))
    assert frame.camera_info.header.stamp.nanosec == 2


def test_swapped_order_gives_each_its_own() -> None:
    pairing = Pairing(PairingConfig())
    pairing.add_camera_info(camera_info())
    pairing.add_image(image(1))
    pairing.add_image(image(2))
    stamps = [pairing.add_detections(detections(s))[0].image.header.stamp.nanosec for s in (2, 1)]
    assert stamps == [2, 1]


def test_repeated_stamps_are_counted_and_answered_once() -> None:
    pairing = Pairing(PairingConfig())
    pairing.add_camera_info(camera_info())
    pairing.add_image(image(1))
    assert len(pairing.add_detections(detections(1))) == 1
    assert pairing.add_image(image(1)) == [] and pairing.add_detections(detections(1)) == []
    assert sum(pairing.dropped.values()) == 2


def test_buffers_are_bounded_by_count_and_bytes() -> None:
    pairing = Pairing(PairingConfig(max_images=3, max_detections=2))
    for stamp in range(10):
        pairing.add_image(image(stamp))
        pairing.add_detections(detections(100 + stamp))
    assert pairing.dropped == {"image without detections": 7, "detections without image": 8}
    small = Pairing(PairingConfig(max_megabytes=2))
    for stamp in range(5):
        small.add_image(image(stamp))
    assert small.waiting()["image waiting for camera_info"] == 2  # 900 KiB each
