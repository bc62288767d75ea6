"""Data URIs, by which a page holds pictures and figures."""

import base64
import io

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

_QUALITY = 88  # of JPEG


def figure_uri(figure: Figure) -> str:
    """A figure as a data URI: SVG, the same bytes for the same figure."""
    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "pinwm", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _uri("image/svg+xml", buffer.getvalue())


def picture_uri(picture: np.ndarray) -> str:
    """A picture (height, width, 3) uint8, sRGB, as a data URI: JPEG."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="JPEG", quality=_QUALITY, subsampling=0, optimize=True)
    return _uri("image/jpeg", buffer.getvalue())


def _uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
