"""Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a pipe table without a trailing newline.

    >>> print(markdown_table(["effect", "nats"], [["sound_speed", 12]]))
    | effect | nats |
    |---|---|
    | sound_speed | 12 |
    """
    lines = [header, *rows]
    text = [f"| {' | '.join(map(str, line))} |" for line in lines]
    return "\n".join([text[0], "|" + "---|" * len(header), *text[1:]])
