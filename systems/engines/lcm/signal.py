# SPDX-License-Identifier: MIT
"""Vectors as LCM messages with a stamp: a robot's states, and the commands of a session."""

import numpy as np
from drake import lcmt_drake_signal  # type: ignore[import-untyped]  # LCM's types
from pydrake.systems.framework import Context, LeafSystem

from pinwm_drake.systems.ports import declare_value
from pinwm_drake.systems.sampling import period_index
from pinwm_drake.systems.scenario.schema import LcmLink

COMMAND_NAMES = ("vx", "vy", "vz", "session", "sequence", "expiry")


class SignalSender(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Message from a vector, with a stamp.

                       ┌──────────────┐
        values  (n) ──►│ SignalSender │─► message  Value[lcmt_drake_signal]: values and their names, stamped with the
                       └──────────────┘   time of the Context [us]; direct feedthrough

    Values that are no finite numbers are sent as they are.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        super().__init__()
        values = self.DeclareVectorInputPort("values", len(names))
        declare_value(
            self,
            "message",
            lcmt_drake_signal(),
            lambda context: signal_message(names, values.Eval(context), context.get_time()),
        )


class CommandSender(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Message of a command, of a session and with an end.

        pusher_velocity  (3): v_WP [m/s], W ──►┌───────────────┐
        session     (1): the controller's    ──►│ CommandSender │─► message  Value[lcmt_drake_signal] (6): v_WP [m/s],
        robot_time  (1): s, robot's clock    ──►└───────────────┘   session, sequence, expiry [s, robot's clock]

    The sequence is the number of the period, so that the system has no state. A command ends `timeout` after the last
    state of the robot that was heard. Without a session the velocity is zero.
    """

    def __init__(self, link: LcmLink) -> None:
        super().__init__()
        self._link = link
        self._velocity = self.DeclareVectorInputPort("pusher_velocity", 3)
        self._session = self.DeclareVectorInputPort("session", 1)
        self._robot_time = self.DeclareVectorInputPort("robot_time", 1)
        declare_value(self, "message", lcmt_drake_signal(), self._CalcMessage)

    def _CalcMessage(self, context: Context) -> lcmt_drake_signal:
        time, session = context.get_time(), 0.0
        if self._session.HasValue(context):
            session = float(self._session.Eval(context)[0])
        velocity = self._velocity.Eval(context) if session else np.zeros(3)
        expiry = float(self._robot_time.Eval(context)[0]) + self._link.timeout
        values = np.array([*velocity, session, period_index(time, self._link.period), expiry])
        return signal_message(COMMAND_NAMES, values, time)


def signal_message(names: tuple[str, ...], values: np.ndarray, time: float) -> lcmt_drake_signal:
    """Message of values (n,) with their names, stamped with a time [s]."""
    message = lcmt_drake_signal()
    message.dim, message.coord = len(names), list(names)
    message.val = np.asarray(values, float).tolist()
    message.timestamp = round(1e6 * time)
    return message
