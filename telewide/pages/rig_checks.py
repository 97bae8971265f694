"""The parts that the pages about a rig share: its checks as a table, and what to do about those that did not pass."""

from __future__ import annotations

import html
from collections.abc import Sequence

from telewide.calibration.quality import Check
from telewide.text import with_options

CHECKS_STYLE = """
.verdict { border-left: 6px solid var(--faint); padding: .4rem .9rem; margin: .8rem 0; font-size: 1.05rem; }
.good { border-color: var(--good); } .usable { border-color: var(--warn); } .insufficient { border-color: var(--bad); }
.mark { font-weight: 600; } .mark.pass { color: var(--good); } .mark.warn { color: var(--warn); }
.mark.fail { color: var(--bad); }
td.words, th.words { text-align: left; white-space: normal; max-width: 60ch; } td.words:empty { padding: 0; }
"""


def checks_html(checks: Sequence[Check]) -> str:
    """Set the checks as a table: result, name, what was found, its limit, advice; nothing without checks."""
    rows = "".join(
        f'<tr><td><span class="mark {check.status}">{check.status}</span></td>'
        f'<td class="words">{html.escape(check.name)}</td>'
        f"<td>{html.escape(check.found_words)}</td><td>{html.escape(check.limit_words)}</td>"
        f'<td class="words">{html.escape(with_options(check.advice))}</td></tr>\n'
        for check in checks
    )
    head = (
        '<tr><th>result</th><th class="words">check</th><th>found</th><th>limit</th><th class="words">advice</th></tr>'
    )
    return f'<div class="scroll"><table><thead>{head}</thead>\n<tbody>{rows}</tbody></table></div>' if rows else ""


def advice_html(checks: Sequence[Check]) -> str:
    """List what to do, failed checks first."""
    worst_first = sorted((check for check in checks if check.advice), key=lambda check: check.status != "fail")
    items = "".join(f"<li>{html.escape(with_options(check.advice))}</li>" for check in worst_first)
    return f"<ol>{items}</ol>" if items else ""
