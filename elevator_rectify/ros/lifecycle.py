"""The node as a managed node (lifecycle): inactive, it subscribes to no image and computes nothing."""

from __future__ import annotations

import sys
from typing import Any

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from elevator_rectify.ros.node import ElevatorRectify
from elevator_rectify.ros.running import run_node


class ManagedElevatorRectify(ElevatorRectify, LifecycleNodeMixin):
    """`ElevatorRectify` with states; with `autostart` it goes through them to active by itself."""

    def __init__(self, **options: Any) -> None:
        self._active = False
        ElevatorRectify.__init__(self, **options)
        LifecycleNodeMixin.__init__(self)
        if self.node_config.autostart:
            self.trigger_configure()
            self.trigger_activate()

    def _begin(self) -> None:
        """Begin when activated, not when made."""
        if self._active:
            super()._begin()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe and compute."""
        self._active = True
        self._begin()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to nothing but the target, whose last text stays valid."""
        self._end()
        self._active = False
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End what is active."""
        return self.on_deactivate(state) if self._active else TransitionCallbackReturn.SUCCESS

    def _end_worker(self) -> None:
        if self._active:
            super()._end_worker()


def main(args: list[str] | None = None) -> int:
    """Run the managed node until it is interrupted; 0 on a clean end, 2 for wrong parameters."""
    return run_node(ManagedElevatorRectify, args)


if __name__ == "__main__":
    sys.exit(main())
