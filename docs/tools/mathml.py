"""Formulas as MathML when the site is built, so that pages need no script and no network.

``$…$`` within a line and ``$$…$$`` as a paragraph of their own, in LaTeX; pymdownx.arithmatex finds them.
"""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

_INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
_DISPLAY = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """A page's HTML with its formulas in MathML."""
    content = _INLINE.sub(lambda found: convert(html.unescape(found[1])), content)
    return _DISPLAY.sub(
        lambda found: f'<div class="formula">{convert(html.unescape(found[1]).strip(), display="block")}</div>', content
    )
