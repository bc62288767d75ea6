# SPDX-License-Identifier: MIT
"""Web pages inside a notebook: the whole page is in the output, so that no server and no file is needed."""

import base64
import gzip
import html
import re
from dataclasses import dataclass, field

# Meshcat's page carries decoders of compressed meshes and textures, two thirds of its size. Drake's scenes have none.
_DECODER = re.compile(r'(?<=")data:application/(?:wasm|javascript);base64,[A-Za-z0-9+/=]*(?=")')
# The browser unpacks the page, and becomes it.
_LOADER = """<script>
(async () => {
  const packed = Uint8Array.from(atob("%s"), (letter) => letter.charCodeAt(0));
  const page = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const text = await new Response(page).text();
  document.open();
  document.write(text);
  document.close();
})();
</script>"""


@dataclass(frozen=True)
class InlinePage:
    """Page that a notebook shows in a frame of its own.

    Attributes:
        page: HTML of a whole page.
        height: px, of the frame.
    """

    page: str = field(repr=False)
    height: int = 420

    def _repr_html_(self) -> str:
        packed = base64.b64encode(gzip.compress(self.page.encode(), mtime=0)).decode()
        frame = html.escape(_LOADER % packed, quote=True)
        return f'<iframe srcdoc="{frame}" width="100%" height="{self.height}" style="border: 0"></iframe>'


def inline_page(page: str, height: int = 420) -> InlinePage:
    """Return a page for display in a notebook, such as Meshcat's recording.

        pw.inline_page(meshcat.StaticHtml())

    The output holds all of the page, packed: it is shown where nothing listens, in JupyterLab as on a web site.

    Args:
        page: HTML of a whole page that loads nothing from elsewhere.
        height: px, of the frame.
    """
    return InlinePage(_DECODER.sub("data:,", page), height)
