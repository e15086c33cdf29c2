from collections.abc import Callable
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from elevator_rectify.ros.config import PairingConfig
from elevator_rectify.ros.convert import stamp_ns
from elevator_rectify.ros.pairing import Pairing
from elevator_rectify.ros.waiting import Waiting
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


def test_where_every_image_has_its_own_camera_info_a_frame_waits_for_it() -> None:
    """Topics overtake each other: the newest info may be that of the image before."""
    pairing = Pairing(PairingConfig())
    for stamp in (1, 2):
        pairing.add_camera_info(camera_info(stamp))
        pairing.add_image(image(stamp))
        assert len(pairing.add_detections(detections(stamp))) == 1
    pairing.add_image(image(3))
    assert pairing.add_detections(detections(3)) == []
    (frame,) = pairing.add_camera_info(camera_info(3))
    assert stamp_ns(frame.camera_info.header) == 3
    pairing.add_image(image(4))
    assert pairing.add_detections(detections(4)) == []
    (frame,) = pairing.add_camera_info(camera_info(5))
    assert stamp_ns(frame.image.header) == 4, "its own info was lost"


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


def test_a_tolerance_takes_the_nearest_image_once_a_later_one_is_there() -> None:
    pairing = Pairing(PairingConfig(tolerance_s=0.02))
    pairing.add_camera_info(camera_info())
    ms = 1_000_000
    assert pairing.add_image(image(100 * ms)) == [] and pairing.add_detections(detections(115 * ms)) == []
    (frame,) = pairing.add_image(image(120 * ms))
    assert stamp_ns(frame.image.header) == 120 * ms and stamp_ns(frame.detections.header) == 115 * ms
    assert pairing.add_detections(detections(160 * ms)) == [] and pairing.add_image(image(200 * ms)) == []


def test_without_a_tolerance_only_equal_stamps_pair() -> None:
    pairing = Pairing(PairingConfig())
    pairing.add_camera_info(camera_info())
    pairing.add_image(image(100))
    pairing.add_image(image(102))
    assert pairing.add_detections(detections(101)) == []


def test_a_clock_that_goes_back_clears_the_buffers() -> None:
    """A bag that is played in a loop: its stamps come again, and must not count as repeated."""
    pairing = Pairing(PairingConfig())
    pairing.add_camera_info(camera_info(5))
    second = 1_000_000_000
    for stamp in (1, 2, 3):
        pairing.add_image(image(stamp * second))
    assert len(pairing.add_detections(detections(2 * second))) == 1
    pairing.add_image(image(1 * second))
    assert pairing.jumps == 1 and pairing.dropped["image: clock went back"] == 2
    assert len(pairing.add_detections(detections(1 * second))) == 1
    pairing.add_image(image(2 * second))
    assert len(pairing.add_detections(detections(2 * second))) == 1


@settings(max_examples=200, deadline=None)
@given(
    events=st.lists(
        st.tuples(st.sampled_from(["image", "detections", "camera_info"]), st.integers(0, 40)), max_size=60
    ),
    tolerance=st.sampled_from([0.0, 0.1]),
)
def test_every_image_and_detection_is_accounted_for(events: list[tuple[str, int]], tolerance: float) -> None:
    config = PairingConfig(max_images=4, max_detections=3, tolerance_s=tolerance)
    pairing, frames = Pairing(config), 0
    make: dict[str, Callable[[int], Any]] = {"image": image, "detections": detections, "camera_info": camera_info}
    for kind, stamp in events:
        frames += len(getattr(pairing, f"add_{kind}")(make[kind](stamp * 100_000_000)))
    for kind in ("image", "detections"):
        dropped = sum(n for reason, n in pairing.dropped.items() if reason.startswith(kind))
        waiting = sum(n for reason, n in pairing.waiting().items() if reason.startswith(kind))
        assert pairing.received[kind] == frames + dropped + waiting


def test_beyond_its_length_the_queue_drops_the_oldest() -> None:
    pairing, waiting = Pairing(PairingConfig()), Waiting(2)
    pairing.add_camera_info(camera_info())
    late = []
    for stamp in range(1, 5):
        pairing.add_image(image(stamp))
        (frame,) = pairing.add_detections(detections(stamp))
        late += waiting.put(frame)
    assert [stamp_ns(f.image.header) for f in late] == [1, 2]
    first = waiting.get()
    assert first is not None and stamp_ns(first.image.header) == 3
    assert waiting.close() == 1 and waiting.get() is None


MILLISECOND = 1_000_000


def test_a_short_bag_is_answered_in_every_loop() -> None:
    pairing, answered = Pairing(PairingConfig()), 0
    for _ in range(5):
        for k in range(10):
            stamp = (k + 1) * 50 * MILLISECOND
            frames = pairing.add_camera_info(camera_info(stamp)) + pairing.add_image(image(stamp))
            answered += len(frames + pairing.add_detections(detections(stamp)))
    assert answered == 50 and pairing.jumps == 4


def synchronised(config: PairingConfig = PairingConfig()) -> tuple[Pairing, int]:  # noqa: B008
    """Return a pairing that has seen some images with a camera info each, and the next stamp."""
    pairing = Pairing(config)
    for k in range(3):
        stamp = (k + 1) * 33 * MILLISECOND
        pairing.add_camera_info(camera_info(stamp))
        pairing.add_image(image(stamp))
        assert len(pairing.add_detections(detections(stamp))) == 1
    return pairing, 4 * 33 * MILLISECOND


def test_a_camera_info_that_stops_does_not_silence_the_node() -> None:
    pairing, stamp = synchronised()
    answered = []
    for k in range(40):
        at = stamp + k * 33 * MILLISECOND
        answered += pairing.add_image(image(at)) + pairing.add_detections(detections(at))
    # Half a second of them waits for an info at first; then the last info serves at once.
    assert len(answered) == 40 and pairing.lost_infos == 1
    assert {stamp_ns(f.camera_info.header) for f in answered} == {99 * MILLISECOND}


def test_a_frame_waits_for_its_depth_and_takes_a_near_one_within_the_tolerance() -> None:
    pairing, stamp = synchronised(PairingConfig(tolerance_s=0.002))
    pairing.needs_depth = True
    pairing.add_depth(image(1))
    pairing.add_camera_info(camera_info(stamp))
    pairing.add_image(image(stamp))
    pairing.add_image(image(stamp + 33 * MILLISECOND))
    assert pairing.add_detections(detections(stamp)) == []
    (frame,) = pairing.add_depth(image(stamp + MILLISECOND))
    assert stamp_ns(frame.image.header) == stamp and stamp_ns(frame.depth.header) == stamp + MILLISECOND


def test_a_depth_that_was_lost_is_not_waited_for() -> None:
    pairing, stamp = synchronised()
    pairing.needs_depth = True
    pairing.add_depth(image(1))
    pairing.add_camera_info(camera_info(stamp))
    pairing.add_image(image(stamp))
    assert pairing.add_detections(detections(stamp)) == []
    (frame,) = pairing.add_depth(image(stamp + 33 * MILLISECOND))
    assert frame.depth is None
    never = synchronised()[0]
    never.needs_depth = True
    never.add_camera_info(camera_info(stamp))
    never.add_image(image(stamp))
    assert len(never.add_detections(detections(stamp))) == 1, "nothing comes on the topic at all"


def test_depth_images_obey_the_bounds_and_are_counted() -> None:
    pairing = Pairing(PairingConfig(max_images=4))
    for stamp in range(10):
        pairing.add_depth(image(stamp))
    assert pairing.received["depth"] == 10 and pairing.dropped["depth without image"] == 6
    large = Pairing(PairingConfig(max_megabytes=2))
    for stamp in range(10):
        large.add_depth(image(stamp))
    assert large.dropped["depth without image"] == 8, "of 900 KiB each"
