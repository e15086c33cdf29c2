"""The programs that load the live node, in small."""

from __future__ import annotations

import pytest

from elevator_rectify.live import chaos, latency, soak
from elevator_rectify.ros.goals import action
from test.harness import DOMAIN


def test_chaos_finds_nothing_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    assert chaos.main(["--minutes", "0.4", "--seed", "3", "--domain", str(DOMAIN)]) == 0
    said = capsys.readouterr().out
    assert "0 things went wrong" in said and "refused: bad_input" in said and "pose: ok" in said
    if action("FindButton") is not None:
        assert "goals: " in said and "bad_request" in said


def test_every_frame_is_answered_beside_the_relay(capsys: pytest.CaptureFixture[str]) -> None:
    assert latency.main(["--frames", "40", "--domain", str(DOMAIN)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[2:]] == ["relay", "node", "node,"]


def test_the_soak_sees_flat_memory_and_every_answer(capsys: pytest.CaptureFixture[str]) -> None:
    assert soak.main(["--frames", "60", "--domain", str(DOMAIN)]) == 0
    assert "60 of 60 frames answered" in capsys.readouterr().out
