"""Sessions: a survey plan, measured cell by cell into a recording that survives a power cut.

A cell is one condition and all its pings; see `acquisition.io.journal` for how it is kept. Needs numpy and pandas alone,
so it runs on the small machine that the sonar is wired to.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd

from acquisition.errors import NoAnswerError, RecordingError, SettingError
from acquisition.io.journal import Journal
from acquisition.io.recording import ECHO_COLUMN, Recording
from acquisition.ping import Reading
from acquisition.survey.plan import Cell, Plan
from acquisition.survey.quantities import CONDITIONS
from acquisition.survey.sources import Measured, Source

Progress = Callable[[int, int], None]
SILENT_CELLS = 5  # in a row, after which an operator is asked whether the sonar is deaf
DIGITS = 4  # of a condition's value, for telling whether two are the same


class Answer(Enum):
    """What an operator wants."""

    GO = "go on"
    SKIP = "skip"
    REPEAT = "repeat"
    QUIT = "quit"


class Operator(Protocol):
    """Whoever moves the stand and watches over a session."""

    def ready(self, before: Cell | None, cell: Cell, can_repeat: bool) -> Answer:
        """Have a cell arranged. SKIP leaves it for later, REPEAT takes the one before back, QUIT ends the session."""

    def unanswered(self, error: NoAnswerError) -> Answer:
        """Tell of a dead wire. GO measures the cell again, SKIP leaves it for later, QUIT gives up."""

    def silent(self, cells: int) -> Answer:
        """Tell that nothing was heard for some cells. GO tests again, SKIP believes it, QUIT ends the session."""


class Nobody:
    """No operator: what can be measured is measured, a dead wire ends the session, and silence is believed."""

    def ready(self, before: Cell | None, cell: Cell, can_repeat: bool) -> Answer:
        """Go on."""
        return Answer.GO

    def unanswered(self, error: NoAnswerError) -> Answer:
        """Give up."""
        return Answer.QUIT

    def silent(self, cells: int) -> Answer:
        """Believe it."""
        return Answer.SKIP


@dataclass(frozen=True)
class Session:
    """Measure a plan into a file.

    Attributes:
        plan: what to measure.
        source: what to measure it with.
        path: of the recording, CSV.
        resume: go on with a recording that is there, rather than refuse to touch it.
        echoes: how many echoes a ping to write down, 1..17.
        sensor: what to call the sensor.
        operator: whoever moves the stand.
        settings: of the hardware, as numbers and text; a session is resumed only with the same ones.
    """

    plan: Plan
    source: Source
    path: Path
    resume: bool = False
    echoes: int = 4
    sensor: str = "0"
    operator: Operator = field(default_factory=Nobody)
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a number of echoes that no recording holds."""
        if not 1 <= self.echoes <= 17:
            raise SettingError(f"echoes must lie from 1 to 17, got {self.echoes}: a sonar has 17 echo registers")

    def run(self, progress: Progress | None = None) -> Path:
        """Measure what is still to be measured.

        Args:
            progress: called with pings done and pings in all, after each cell.

        Raises:
            RecordingError: the file is there and `resume` was not asked for, it belongs to another plan, another
                process is writing it, or the disk is full or fails.
            NoAnswerError: the wire is dead, and the operator gave up. Whole cells are on disk, whatever happens.
        """
        with Journal.open(self.path, self.plan.pings, self.resume) as journal:
            todo = self._todo(journal)
            journal.begin(self._begun_with())
            if todo:
                Survey(self, journal, todo, progress).run()
            if journal.cells == len(self.plan):
                journal.finish()
        return self.path

    def _begun_with(self) -> dict[str, Any]:
        return {**asdict(self.plan), "echoes": self.echoes, "sensor": self.sensor, **self.settings}

    def _todo(self, journal: Journal) -> deque[int]:
        """Return the numbers of the cells that the file does not hold yet."""
        if journal.table is None:
            return deque(range(len(self.plan)))
        self._check_echoes(journal.table)
        done = self._conditions(journal.table)
        due = {_key(cell): number for number, cell in enumerate(self.plan.cells)}
        counted = Counter(done[:: self.plan.pings])
        for row, key in enumerate(done):
            if key not in due or key != done[row - row % self.plan.pings] or counted[key] > 1:
                raise RecordingError(
                    f"{self.path}, line {row + 2}: holds another condition than the plan has there; "
                    "resume with the plan and pings a cell that it was begun with"
                )
        return deque(sorted(set(due.values()) - {due[key] for key in counted}))

    def _check_echoes(self, table: pd.DataFrame) -> None:
        deepest = 1 + sum(ECHO_COLUMN.fullmatch(str(name)) is not None for name in table)
        if deepest != self.echoes:
            raise RecordingError(
                f"{self.path}: holds {deepest} echoes a ping, this session {self.echoes}; give the same number"
            )

    def _conditions(self, table: pd.DataFrame) -> list[tuple[float, ...]]:
        """Return the condition of each row, to be compared with those of cells."""
        names = [*CONDITIONS, *self.plan.sweep]
        missing = [name for name in names if name not in table]
        if missing:
            raise RecordingError(f"{self.path}, line 1: column {missing[0]} is missing; resume with the same plan")
        number = table[names].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
        return [tuple(row) for row in number.round(DIGITS).tolist()]


def _key(cell: Cell) -> tuple[float, ...]:
    return tuple(np.round(list(cell.values.values()), 6).round(DIGITS).tolist())  # as a recording rounds it


@dataclass
class Survey:
    """One session under way: what is to be done, and what was done last.

    Attributes:
        session: that it belongs to.
        journal: open file.
        todo: numbers of cells.
        progress: see `Session.run`.
    """

    session: Session
    journal: Journal
    todo: deque[int]
    progress: Progress | None

    def __post_init__(self) -> None:
        """Number the session: hardware taken up again is another one, for its clock went on."""
        table = self.journal.table
        last = 0 if table is None else int(table["session"].iloc[-1])
        self.number = last if table is None or self.session.source.simulated else last + 1
        self.last: int | None = None
        self.standing: Cell | None = None
        self.silent = 0

    def run(self) -> None:
        """Make sure that the sonar answers, and go through the cells until the last or until somebody quits."""
        if self.journal.cells:
            self._tell()  # so that what was done before counts for nothing in the time that is left
        if self._answers() is Answer.QUIT:
            return
        while self.todo:
            cell = self.session.plan.cell(self.todo[0])
            answer = self.session.operator.ready(self.standing, cell, self.last is not None)
            if answer is Answer.GO:
                self.standing = cell
                answer = self._measure()
            if answer is Answer.QUIT:
                return
            if answer is Answer.SKIP:
                self.todo.popleft()
            elif answer is Answer.REPEAT:
                self._take_back()

    def _answers(self) -> Answer:
        """Have the wire tested before anything is written down."""
        while True:
            try:
                heard = self.session.source.check()
            except NoAnswerError as error:
                if self.session.operator.unanswered(error) is not Answer.GO:
                    raise
                continue
            answer = Answer.SKIP if heard else self.session.operator.silent(0)
            if answer is not Answer.GO:
                return answer

    def _measure(self) -> Answer:
        """Measure the next cell and write it down; tell what to do then."""
        try:
            measured = self.session.source.measure(self.session.plan, self.todo[0])
        except NoAnswerError as error:
            answer = self.session.operator.unanswered(error)
            if answer is Answer.QUIT:
                raise
            return answer
        self.journal.append(self._rows(measured))
        self.last = self.todo.popleft()
        self._tell()
        return self._heed(measured.reading)

    def _tell(self) -> None:
        if self.progress is not None:
            pings = self.session.plan.pings
            self.progress(self.journal.cells * pings, len(self.session.plan) * pings)

    def _heed(self, reading: Reading) -> Answer:
        """After some silent cells have the operator test whether the sonar still hears."""
        self.silent = 0 if reading.echo.any() else self.silent + 1
        if self.silent < SILENT_CELLS:
            return Answer.GO
        answer = self.session.operator.silent(self.silent)
        self.silent = 0
        answer = self._answers() if answer is Answer.GO else answer
        return Answer.QUIT if answer is Answer.QUIT else Answer.GO

    def _take_back(self) -> None:
        if self.last is not None:
            self.journal.drop_last()
            self.todo.appendleft(self.last)
            self.last = self.standing = None  # it is to be arranged anew

    def _rows(self, measured: Measured) -> pd.DataFrame:
        reading = measured.reading
        echoes = np.zeros((len(reading), self.session.echoes - 1))
        kept = reading.echoes[:, : self.session.echoes - 1]
        echoes[:, : kept.shape[1]] = kept
        table = Recording.of(measured.ping, Reading(reading.range, reading.status, echoes)).table
        names = {"session": str(self.number), "sensor": self.session.sensor}
        logged: dict[str, Any] = {**names, **measured.columns, **dict(self.session.plan.cell(self.todo[0]).swept)}
        return table.assign(**logged)
