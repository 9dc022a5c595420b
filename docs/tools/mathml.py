"""Formulas become MathML when the site is built, so that pages need no script and no network.

``$…$`` within a line and ``$$…$$`` as a paragraph, in LaTeX; pymdownx.arithmatex marks them.
"""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

_INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
_DISPLAY = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Return a page's HTML with its formulas in MathML."""
    content = _INLINE.sub(lambda match: convert(html.unescape(match[1])), content)
    return _DISPLAY.sub(
        lambda match: f'<div class="formula">{convert(html.unescape(match[1]).strip(), display="block")}</div>', content
    )
