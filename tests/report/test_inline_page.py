# SPDX-License-Identifier: MIT
import base64
import gzip
import html
import re

import pinwm_drake as pw

DECODER = "data:application/wasm;base64," + base64.b64encode(bytes(300)).decode()
PAGE = f'<!DOCTYPE html><html><script>const wasm = "{DECODER}"; let a = "<b>&amp;</b>";</script>é</html>'


def unpacked(shown: str) -> str:
    """The page that a browser gets out of the frame."""
    frame = html.unescape(re.search('srcdoc="([^"]*)"', shown).group(1))
    return gzip.decompress(base64.b64decode(re.search(r'atob\("([^"]*)"\)', frame).group(1))).decode()


def test_the_output_of_a_cell_holds_the_page_less_decoders():
    page = pw.inline_page(PAGE, height=300)
    shown = page._repr_html_()
    assert shown.count("<iframe") == 1
    assert 'height="300"' in shown
    assert unpacked(shown) == PAGE.replace(DECODER, "data:,")
    assert shown == pw.inline_page(PAGE, height=300)._repr_html_()
    # The plain form of an output is one line.
    assert repr(page) == "InlinePage(height=300)"
