"""Curves of learning of several seeds of rows of the zoo.

    python -m benchmarks.curves "PPO, ideal=runs/ideal/*" "PPO, srf08-mlp=runs/mlp/*" --figure docs/images/curves.png

Each argument is a title and the folders that `sonar-gym zoo` wrote, one per seed. Prints a table in Markdown, and
draws the success rate of the last 100 episodes, which were driven with exploration: each seed, the interquartile mean
of all seeds, and its 95 % interval over seeds.
"""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.arrays import Floats
from acquisition.io.files import write_bytes
from training.agents.evaluate import Rate
from training.agents.zoo.board import success_rate
from training.agents.zoo.command import RESULT
from training.common.canvas import AFTER, SOFT, Axes, panels
from training.common.commit import commit
from training.common.records import write_record
from training.common.statistics import AgentScores
from training.common.tables import markdown_table

POINTS = 100  # of a curve
SOLVED = 0.9  # share of the streets of the test
HEADER = ("row", "seeds", "parked, each", "interquartile mean", "90 % or more", "minutes, processor")


@dataclass(frozen=True)
class Row:
    """A row of the zoo.

    Attributes:
        title: its name.
        results: of each seed, as `sonar-gym zoo` writes them.
        steps: of the points of the curves, (p,).
        curves: success rate of each seed, (n, p).
    """

    title: str
    results: Sequence[dict[str, Any]]
    steps: Floats
    curves: Floats

    @classmethod
    def of(cls, text: str) -> Row:
        """Read a row from "title=pattern of folders"."""
        title, pattern = text.split("=", 1)
        folders = [path for path in sorted(map(Path, glob(pattern))) if (path / RESULT).exists()]
        if not folders:
            raise SystemExit(f"{pattern}: no folder with {RESULT}")
        results = [json.loads((folder / RESULT).read_text(encoding="utf-8")) for folder in folders]
        steps = np.linspace(0.0, max(one["steps"] for one in results), POINTS)
        return cls(title, results, steps, np.stack([curve(folder, steps) for folder in folders]))

    @property
    def scores(self) -> AgentScores:
        """Share of the streets of the test in which each seed parked."""
        return AgentScores(np.array([one["share"] for one in self.results]))

    def cells(self) -> tuple[object, ...]:
        """Return the cells of the table."""
        scores, minutes = self.scores, [one["seconds"] / 60.0 for one in self.results]
        low, high = scores.interval(np.random.default_rng(0))
        each = ", ".join(f"{100.0 * one:.1f}" for one in scores.scores)
        return (
            self.title,
            len(scores.scores),
            each,
            f"{100 * scores.centre:.1f} % ({100 * low:.1f} to {100 * high:.1f})",
            Rate(int((scores.scores >= SOLVED).sum()), len(scores.scores)),
            f"{min(minutes):.1f} to {max(minutes):.1f}",
        )


def curve(folder: Path, steps: Floats) -> Floats:
    """Return the success rate at some numbers of steps, 0 before the first that was logged, (p,)."""
    return np.interp(steps, *success_rate(folder), left=0.0)


def figure(record: list[dict[str, Any]]) -> bytes:
    """Return the curves of each row, as PNG."""
    return panels([partial(draw, row) for row in record], (8.0, 3.1 * -(-len(record) // 2)), columns=2)


def draw(row: dict[str, Any], axes: Axes) -> None:
    """Draw the curves of a row: its title, the last step, and the success rate of each seed."""
    rng, curves = np.random.default_rng(0), np.array(row["curves"])
    millions = np.linspace(0.0, row["steps"], POINTS) / 1e6
    middle = [AgentScores(one) for one in curves.T]
    low, high = np.transpose([one.interval(rng) for one in middle])
    axes.plot(millions, 100.0 * curves.T, color=SOFT, linewidth=0.8)
    axes.fill_between(millions, 100.0 * low, 100.0 * high, color=AFTER, alpha=0.2, linewidth=0.0)
    axes.plot(millions, [100.0 * one.centre for one in middle], color=AFTER, linewidth=2.5)
    axes.set(title=row["title"], xlabel="million steps", ylabel="parked (%)", ylim=(-2.0, 102.0))


def main() -> None:
    """Read the rows, print the table, write the record and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="+")
    parser.add_argument("--figure", type=Path, default=Path("docs/images/curves.png"))
    options, made_by = parser.parse_args(), commit()
    rows = [Row.of(text) for text in options.rows]
    print(markdown_table(HEADER, (row.cells() for row in rows)))
    plain = [{"title": row.title, "steps": row.steps[-1], "curves": row.curves} for row in rows]
    command = shlex.join(["python", "-m", "benchmarks.curves", *options.rows])
    write_bytes(options.figure, figure(write_record(options.figure, made_by, command, plain)))


if __name__ == "__main__":
    main()
