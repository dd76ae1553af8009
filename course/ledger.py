"""The reproduction ledger: every table, figure, equation and claim of the paper, where it is here, and if it holds.

It is made, never typed. The paper's figures are `PAPER_TABLE`; ours are taken from the results of an evaluation, or
from running the library beside the formula as printed; every verdict follows from them by one of these rules:

- Size. Data, lenses and training differ from the paper's, so errors are compared as ratios to ZNCC's in the same
  light; ZNCC's own as they are. Within `TOLERANCE` of the paper's: reproduced. Ratios on the same side of 1: trend
  reproduced. Else: differs.
- Order, such as "SweepNet below ZNCC". True wherever it is in the paper's table: reproduced. In more than half of
  these places: trend reproduced. Else: differs.
- Picture. The paper shows it and prints no figure, so that an order which holds here is a trend reproduced at most.
- Formula. Library and print agree to `EXACT` on random input: reproduced. Else: differs.
- Setting. The same as the paper's: reproduced. Else: differs.

What the results do not hold, or hold at another scale than the paper's, is not evaluated.
"""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import get_args

from course.claims import CLAIMS, DIFFERENCES
from course.findings import EXACT, PERCENT, Claim, Difference, Finding, Verdict, scale_text
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.evaluate.records import Record, config_checksum
from omnistereo_lib.files import atomic_write, read_bytes

MARKERS = ("<!-- ledger -->", "<!-- /ledger -->")


def ledger(results: Record | None = None) -> str:
    """Return the reproduction ledger in Markdown.

    Args:
        results: What `Evaluation.results` returns, or the content of results.json; without, what needs them is not
            evaluated.

    Returns:
        str: Links to notebooks are relative to the repository's root.
    """
    found = [(claim, claim.finding(results)) for claim in CLAIMS]
    parts = [f"{_provenance(results)}\n\n{_rules()}\n\n**In all: {_counts(finding for _, finding in found)}.**\n"]
    for group in dict.fromkeys(claim.group for claim in CLAIMS):
        members = [pair for pair in found if pair[0].group == group]
        rows = [_claim_row(claim, finding) for claim, finding in members]
        table = _table(["claim", "where", "paper", "ours", "verdict"], rows)
        parts.append(_folded(f"{group}: {_counts(finding for _, finding in members)}", table, group == CLAIMS))
    heads = ["", "the paper's text", "the released code", "here", "otherwise", "where"]
    table = _table(heads, map(_difference_row, DIFFERENCES))
    parts.append(_folded("Where the paper's text and the authors' released code differ, and what we do", table))
    return "\n".join(parts)


def split_at_markers(path: str | Path) -> tuple[str, str]:
    """Return a Markdown file's text up to where its ledger begins, and from where it ends; both with their marker.

    Raises:
        OmnistereoError: If the file cannot be read or does not hold each of the two `MARKERS` once, in their order.
    """
    try:
        text = read_bytes(path).decode()
    except UnicodeDecodeError:
        raise OmnistereoError(f"{path} is no text in UTF-8: give a Markdown file") from None
    first, last = MARKERS
    if text.count(first) != 1 or text.count(last) != 1 or text.index(first) > text.index(last):
        raise OmnistereoError(
            f"{path} holds {text.count(first)} × {first} and {text.count(last)} × {last}: "
            "expected one line of each, in this order, where the ledger is to stand"
        )
    return text[: text.index(first) + len(first)], text[text.index(last) :]


def write_ledger(path: str | Path, results: Record | None = None) -> None:
    """Replace what stands between the two `MARKERS` of a Markdown file by the ledger, whole or not at all.

    Raises:
        OmnistereoError: As `split_at_markers`, or if the file cannot be written.
    """
    before, after = split_at_markers(path)
    text = f"{before}\n{ledger(results)}{after}"
    with atomic_write(path) as temporary:
        temporary.write_bytes(text.encode())


def _provenance(results: Record | None) -> str:
    made = "Made by `python -m course ledger`, never typed"
    if results is None:
        return f"{made}; no results were given."
    frames = ", ".join(f"{len(frames)} of {name}" for name, frames in sorted(results["frames"].items()))
    weights = "".join(f", {name} `{digest[:12]}`" for name, digest in sorted(results["weights"].items()))
    settings = f"settings `{config_checksum(results)[:12]}`"
    return f"{made}. Results: frames {frames}; {scale_text(results['config'])}; checksums: {settings}{weights}."


def _rules() -> str:
    return (
        "Errors are compared as ratios to ZNCC's in the same light, since the data differ. *Reproduced*: within "
        f"{PERCENT} of the paper's; an order that holds wherever it does in the paper; a formula that the library "
        f"follows to {EXACT:g}; the same setting. *Trend reproduced*: ratios on the same side of 1, an order that "
        "holds in more than half of these places; at most that, where the paper shows a picture and no figure. "
        "*Differs*: neither. *Not evaluated*: not in these results, or not at the paper's scale."
    )


def _counts(findings: Iterable[Finding]) -> str:
    counts = Counter(finding.verdict for finding in findings)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in get_args(Verdict) if counts[verdict])


def _folded(title: str, table: str, is_open: bool = False) -> str:
    return f"<details{' open' * is_open}><summary>{_escaped(title)}</summary>\n\n{table}\n</details>\n"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _claim_row(claim: Claim, finding: Finding) -> list[str]:
    notebook = f"[{claim.notebook[:2]}](notebooks/{claim.notebook}.ipynb)"
    verdict = f"{finding.verdict}\n{finding.reason}" if finding.reason else finding.verdict
    text = claim.text if claim.source == claim.group else f"{claim.source}: {claim.text}"
    cells = [text, claim.paper, finding.ours, verdict]
    text, *others = map(_cell, cells)
    return [text, f"{_code(claim.where)} · {notebook}", *others]


def _difference_row(difference: Difference) -> list[str]:
    follows = "" if difference.follows == "own" else difference.follows
    here = ": ".join(filter(None, (follows, difference.here)))
    option = f"`{difference.option}`" if difference.option else ""
    cells = map(_cell, (difference.topic, difference.paper, difference.code, here))
    return [*cells, option, _code(difference.where)]


def full_name(where: str) -> str:
    """Return the full name of what a row names, such as omnistereo_lib.stereo.sgm.sgm."""
    name = where.replace(":", ".")
    return name if name.startswith("render.") else f"omnistereo_lib.{name}"


def _code(where: Sequence[str]) -> str:
    return ", ".join(f"`{name.replace(':', '.')}`" for name in where)


def _cell(text: str) -> str:
    """Return a cell of a Markdown table: the first line, and the others small."""
    first, _, rest = _escaped(text).partition("\n")
    return f"{first}<br><sub>{rest}</sub>" if rest else first


def _escaped(text: str) -> str:
    return html.escape(text, quote=False).replace("|", "\\|")
