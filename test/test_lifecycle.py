"""The managed node over real DDS: what it subscribes to, and answers, in each state."""

from __future__ import annotations

import pytest
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState

from test.harness import INPUTS, Harness, stop
from test.test_live import frame, live


class Manager:
    """Moves the node from state to state, as a lifecycle manager does."""

    def __init__(self, harness: Harness) -> None:
        self.harness = harness
        self._change = harness.node.create_client(ChangeState, "/elevator_rectify/change_state")
        self._get = harness.node.create_client(GetState, "/elevator_rectify/get_state")
        assert harness.until(self._get.service_is_ready) and harness.until(self._change.service_is_ready)

    def to(self, transition: int) -> bool:
        asked = self._change.call_async(ChangeState.Request(transition=Transition(id=transition)))
        assert self.harness.until(asked.done, 10.0)
        return bool(asked.result().success)

    def state(self) -> int:
        asked = self._get.call_async(GetState.Request())
        assert self.harness.until(asked.done, 10.0)
        return int(asked.result().current_state.id)

    def listens(self) -> list[bool]:
        return [self.harness.node.count_subscribers(name) > 0 for name in INPUTS]

    def silent(self) -> bool:
        return self.harness.until(lambda: not any(self.listens()), 5.0)


@pytest.mark.parametrize("signal_in", ["active", "inactive"])
def test_only_the_active_node_subscribes_and_answers(signal_in: str) -> None:
    with live("-p", "autostart:=false", program="lifecycle_node") as (process, harness):
        manager = Manager(harness)
        assert manager.state() == State.PRIMARY_STATE_UNCONFIGURED and not any(manager.listens())
        assert manager.to(Transition.TRANSITION_CONFIGURE)
        assert manager.state() == State.PRIMARY_STATE_INACTIVE and not any(manager.listens())
        for answers in (1, 2):
            assert manager.to(Transition.TRANSITION_ACTIVATE)
            assert harness.until(harness.connected) and all(manager.listens())
            harness.send(**frame(answers))
            assert harness.answered(answers) and harness.statuses()[-1] == "ok"
            if answers == 2 and signal_in == "active":
                break
            assert manager.to(Transition.TRANSITION_DEACTIVATE)
            assert manager.silent()
            harness.send(**frame(10 + answers))
            harness.until(lambda: False, 0.5)
            assert len(harness.statuses()) == answers
        stop(process)


def test_it_starts_by_itself_and_shuts_down() -> None:
    with live(program="lifecycle_node") as (process, harness):
        manager = Manager(harness)
        assert harness.until(harness.connected) and manager.state() == State.PRIMARY_STATE_ACTIVE
        harness.send(**frame(1))
        assert harness.answered(1)
        assert manager.to(Transition.TRANSITION_ACTIVE_SHUTDOWN)
        assert manager.state() == State.PRIMARY_STATE_FINALIZED
        assert manager.silent()
        stop(process)
