"""Conversion of vectors to LCM messages with a stamp, and back."""

import numpy as np
from drake import lcmt_drake_signal  # type: ignore[import-untyped]  # LCM's types
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from pinwm_drake.systems.engines.lcm.clock import Heard

_TOLERANCE = 1e-9  # s, of a time-out: far more than rounding, far less than a period


class SignalSender(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Message from a vector, with a stamp.

                       ┌──────────────┐
        values  (n) ──►│ SignalSender │─► message  Value[lcmt_drake_signal]: values and their names, stamped with the
                       └──────────────┘   time of the Context [us]; direct feedthrough

    Values that are no finite numbers are sent as they are.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        """Declares the ports; `names` are those of the n values."""
        super().__init__()
        self._names = list(names)
        self._values = self.DeclareVectorInputPort("values", len(names))
        self.DeclareAbstractOutputPort("message", lambda: AbstractValue.Make(lcmt_drake_signal()), self._CalcMessage)

    def _CalcMessage(self, context: Context, output: AbstractValue) -> None:
        message = output.get_mutable_value()
        message.dim, message.coord = len(self._names), self._names
        message.val = self._values.Eval(context).tolist()
        message.timestamp = round(1e6 * context.get_time())


class SignalReceiver(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Vector from messages, for as long as they come.

                                             ┌────────────────┐
        message  Value[lcmt_drake_signal] ──►│                │─► values  (n): NaN where none has come for `timeout`
                                             │ SignalReceiver │─► last    (n): those of the last message
                                             │                │─► time    (1): s, when it was sent, see `Heard`; -1
                                             └────────────────┘   before the first

    The state, updated every `period`: the last message and when it came. The ports show a message that has just come
    at once. One that has another number of values is none.
    """

    def __init__(self, size: int, period: float, timeout: float, first: np.ndarray | None = None) -> None:
        """Declares state and ports.

        Args:
            size: Number n of values.
            period: Period of the state's updates, s.
            timeout: Silence after which `values` is NaN, s.
            first: (n,), values that `last` shows before the first message; None for zeros.
        """
        super().__init__()
        self._size, self._timeout = size, timeout + _TOLERANCE
        first = np.zeros(size) if first is None else np.asarray(first, float).reshape(size)
        start = Heard()
        self._message = self.DeclareAbstractInputPort("message", AbstractValue.Make(lcmt_drake_signal()))
        self.DeclareDiscreteState(BasicVector(np.array([start.stamp, start.arrival, start.offset, *first])))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._Update)
        self.DeclareVectorOutputPort("values", size, self._CalcValues)
        self.DeclareVectorOutputPort("last", size, self._CalcLast, {self._message.ticket(), self.xd_ticket()})
        self.DeclareVectorOutputPort("time", 1, self._CalcTime)

    def _now(self, context: Context) -> tuple[Heard, np.ndarray]:
        """Record of the last message, and its values, at this moment."""
        state = context.get_discrete_state_vector().value()
        heard, values = Heard(*state[:3]), state[3:]
        message = self._message.Eval(context)
        if message.dim != self._size or len(message.val) != self._size:
            return heard, values
        known = heard.hear(message.timestamp, context.get_time(), self._timeout)
        return known, values if known is heard else np.array(message.val)

    def _Update(self, context: Context, values: DiscreteValues) -> None:
        heard, found = self._now(context)
        values.get_mutable_vector().SetFromVector([heard.stamp, heard.arrival, heard.offset, *found])

    def _CalcValues(self, context: Context, output: BasicVector) -> None:
        heard, found = self._now(context)
        fresh = context.get_time() - heard.arrival <= self._timeout
        output.SetFromVector(found if fresh else np.full(self._size, np.nan))

    def _CalcLast(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._now(context)[1])

    def _CalcTime(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, max(self._now(context)[0].time, -1.0))
