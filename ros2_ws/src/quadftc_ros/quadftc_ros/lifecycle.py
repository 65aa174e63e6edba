# pyright: basic
"""The lifecycle of a node, by the standard services: configure, activate, deactivate, clean up, shut down."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ManagedNode(LifecycleNode):
    """A node that rests unless it is active; arguments are those of ``rclpy.node.Node``."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.active = False
        service = self._service_change_state
        service.callback = partial(_answering, service.callback)

    def begin(self) -> None:
        """Become active, at the end of the constructor."""
        self.trigger_configure()
        self.trigger_activate()

    def must_act(self) -> str:
        """Return why the node must stay active; empty: it may rest."""
        return ""

    def resume(self) -> None:
        """Begin, or go on after a rest; by default as after a gap in the samples."""

    def forget(self) -> None:
        """Forget what came, so that the next sample is the first."""

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take and give messages from now on."""
        self.resume()
        self.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Neither take nor give messages from now on, unless the node must act."""
        if reason := self.must_act():
            self.get_logger().warning(f"stays active: {reason}")
            return FAILURE
        self.active = False
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Rest for good; the process goes on until it is told to end."""
        self.active = False
        return super().on_shutdown(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget what came."""
        self.forget()
        return super().on_cleanup(state)

    def destroy_node(self) -> None:
        """Destroy the state machine, too, which would keep the node in the graph."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()


def _answering(answer: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    """Refuse a transition that the state does not have: rclpy raises an exception, which ends the node."""
    try:
        return answer(request, response)
    except RuntimeError:
        response.success = False
        return response
