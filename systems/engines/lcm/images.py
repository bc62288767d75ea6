"""Pictures of a robot's camera, as a station shows them, and their times."""

import numpy as np
from drake import lcmt_image_array  # type: ignore[import-untyped]  # LCM's types
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem, ValueProducer
from pydrake.systems.sensors import ImageRgba8U

from pinwm_drake.errors import InputError
from pinwm_drake.systems.engines.lcm.clock import Heard


class ReceivedImage(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Image from Drake's LcmImageArrayToImages in the form of the station's ports.

                                     ┌───────────────┐
        color_image  ImageRgba8U ───►│ ReceivedImage │─► rgb  ImageRgba8U (W x H): white, alpha 0 before the first one
                                     │               │─► rgb_batch  Value[array]: the same, (1, H, W, 4) uint8
                                     └───────────────┘   direct feedthrough

    Pixels with alpha 0 are made white.
    """

    def __init__(self, width: int, height: int, channel: str) -> None:
        """Declares the ports.

        Args:
            width: W, px.
            height: H, px.
            channel: Channel of the pictures, for messages.
        """
        super().__init__()
        self._shape, self._channel = (height, width, 4), channel
        self._image = self.DeclareAbstractInputPort("color_image", AbstractValue.Make(ImageRgba8U()))
        self._picture = self.DeclareCacheEntry(
            "picture",
            ValueProducer(allocate=lambda: AbstractValue.Make(object()), calc=self._CalcPicture),
            {self._image.ticket()},
        )
        made = {self._picture.ticket()}
        self.DeclareAbstractOutputPort(
            "rgb", lambda: AbstractValue.Make(ImageRgba8U(width, height)), self._CalcRgb, made
        )
        self.DeclareAbstractOutputPort("rgb_batch", lambda: AbstractValue.Make(object()), self._CalcRgbBatch, made)

    def _CalcPicture(self, context: Context, value: AbstractValue) -> None:
        data = np.asarray(self._image.Eval(context).data)
        if data.size == 0:
            value.set_value(np.full(self._shape, (255, 255, 255, 0), np.uint8))
            return
        if data.shape != self._shape:
            height, width, _ = self._shape
            found = f"an image of {data.shape[1]} x {data.shape[0]} px"
            raise InputError(self._channel, value=found, allowed=f"{width} x {height} px, as the scenario's camera")
        picture = data.copy()
        picture[picture[..., 3] == 0, :3] = 255
        value.set_value(picture)

    def _CalcRgb(self, context: Context, output: AbstractValue) -> None:
        output.get_mutable_value().mutable_data[:] = self._picture.Eval(context)

    def _CalcRgbBatch(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._picture.Eval(context)[None])


class ImageTime(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Time at which the last picture was taken.

                                            ┌───────────┐
        message  Value[lcmt_image_array] ──►│ ImageTime │─► rgb_time  (1): s, see `Heard`; -1 before the first
                                            └───────────┘

    The state, updated every `period`: the last stamp, its arrival, and the offset of the clocks.
    """

    def __init__(self, period: float, timeout: float) -> None:
        """Declares state and ports; `period` and `timeout` are in s, the latter as in `Heard.hear`."""
        super().__init__()
        self._timeout, start = timeout, Heard()
        self._message = self.DeclareAbstractInputPort("message", AbstractValue.Make(lcmt_image_array()))
        self.DeclareDiscreteState(BasicVector(np.array([start.stamp, start.arrival, start.offset])))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._Update)
        self.DeclareVectorOutputPort("rgb_time", 1, self._CalcTime)

    def _now(self, context: Context) -> Heard:
        heard = Heard(*context.get_discrete_state_vector().value())
        message = self._message.Eval(context)
        if message.num_images < 1:
            return heard
        return heard.hear(message.header.utime, context.get_time(), self._timeout)

    def _Update(self, context: Context, values: DiscreteValues) -> None:
        heard = self._now(context)
        values.get_mutable_vector().SetFromVector([heard.stamp, heard.arrival, heard.offset])

    def _CalcTime(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, max(self._now(context).time, -1.0))
