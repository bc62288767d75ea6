"""The picture of an object from those of a camera that sees more."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem, ValueProducer
from pydrake.systems.sensors import ImageLabel16I, ImageRgba8U

from pinwm_drake.systems.capture_rig import downsample
from pinwm_drake.systems.push_plant import OBJECT_LABEL


class ObjectImage(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Cuts the object out of a camera's picture, and makes one pixel of several.

                                                   ┌─────────────┐
        color_image  ImageRgba8U   (s W x s H) ───►│ ObjectImage │─► rgb  ImageRgba8U (W x H): sRGB, alpha 255 where
        label_image  ImageLabel16I (s W x s H) ───►│             │   the object is seen; white, alpha 0 elsewhere
                                                   │             │─► rgb_batch  Value[array]: the same, (1, H, W, 4)
                                                   └─────────────┘   direct feedthrough

    The picture is made once for both ports. See `capture_rig.downsample`.
    """

    def __init__(self, width: int, height: int, supersampling: int) -> None:
        """Declares the ports.

        Args:
            width: W, px.
            height: H, px.
            supersampling: s.
        """
        super().__init__()
        self._factor = supersampling
        size = (supersampling * width, supersampling * height)
        self._colour = self.DeclareAbstractInputPort("color_image", AbstractValue.Make(ImageRgba8U(*size)))
        self._label = self.DeclareAbstractInputPort("label_image", AbstractValue.Make(ImageLabel16I(*size)))
        self._picture = self.DeclareCacheEntry(
            "picture",
            ValueProducer(allocate=lambda: AbstractValue.Make(object()), calc=self._CalcPicture),
            {self._colour.ticket(), self._label.ticket()},
        )
        made = {self._picture.ticket()}
        self.DeclareAbstractOutputPort(
            "rgb", lambda: AbstractValue.Make(ImageRgba8U(width, height)), self._CalcRgb, made
        )
        self.DeclareAbstractOutputPort("rgb_batch", lambda: AbstractValue.Make(object()), self._CalcRgbBatch, made)

    def _CalcPicture(self, context: Context, value: AbstractValue) -> None:
        colour = np.asarray(self._colour.Eval(context).data)[..., :3]
        label = np.asarray(self._label.Eval(context).data)[..., 0]
        value.set_value(downsample(colour, label == int(OBJECT_LABEL), self._factor))

    def _CalcRgb(self, context: Context, output: AbstractValue) -> None:
        output.get_mutable_value().mutable_data[:] = self._picture.Eval(context)

    def _CalcRgbBatch(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._picture.Eval(context)[None])
