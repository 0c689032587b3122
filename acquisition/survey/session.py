"""Sessions: a survey plan measured condition by condition into a recording that survives interruptions.

Each condition is one visit: all its pings without interruption. See `acquisition.io.journal` for the file. Requires
numpy and pandas only, so that it runs on the small computer to which the sonar is connected.
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
from acquisition.io.columns import ECHO_COLUMN
from acquisition.io.journal import Journal
from acquisition.io.recording import Recording
from acquisition.ping import Reading
from acquisition.survey.plan import Condition, SurveyPlan
from acquisition.survey.quantities import CONDITION_QUANTITIES
from acquisition.survey.sources import PingSource, VisitData

Progress = Callable[[int, int], None]
MAX_SILENT = 5  # consecutive conditions without any echo, after which the operator checks the sonar
DIGITS = 4  # decimal places to which the values of two conditions are compared


class Answer(Enum):
    """Decision of the operator."""

    GO = "go on"
    SKIP = "skip"
    REPEAT = "repeat"
    QUIT = "quit"


class Operator(Protocol):
    """The person who moves the reflector and supervises a session."""

    def ready(self, before: Condition | None, condition: Condition, can_repeat: bool) -> Answer:
        """Set up a condition. SKIP postpones it, REPEAT measures the previous one again, QUIT ends the session."""

    def unanswered(self, error: NoAnswerError) -> Answer:
        """Report a failed connection. GO measures the condition again, SKIP postpones it, QUIT raises the error."""

    def silent(self, conditions: int) -> Answer:
        """Report conditions without any echo. GO tests the sonar again, SKIP accepts them, QUIT ends the session."""


class NoOperator:
    """Unattended session: a failed connection ends it, and conditions without echo are accepted."""

    def ready(self, before: Condition | None, condition: Condition, can_repeat: bool) -> Answer:
        """Return GO."""
        return Answer.GO

    def unanswered(self, error: NoAnswerError) -> Answer:
        """Return QUIT."""
        return Answer.QUIT

    def silent(self, conditions: int) -> Answer:
        """Return SKIP."""
        return Answer.SKIP


@dataclass(frozen=True)
class Session:
    """Measurement of a plan into a file.

    Attributes:
        plan: conditions to measure.
        source: source of the pings.
        path: of the recording, CSV.
        resume: continue an existing recording; otherwise the file must not exist.
        echoes: number of echoes per ping to record, 1..17.
        sensor: name of the sensor in the recording.
        operator: who sets up the conditions.
        settings: of the hardware, numbers and text; a session can only be resumed with the same settings.
        watch: called with each condition and what was measured, once that is on disk.
    """

    plan: SurveyPlan
    source: PingSource
    path: Path
    resume: bool = False
    echoes: int = 4
    sensor: str = "0"
    operator: Operator = field(default_factory=NoOperator)
    settings: Mapping[str, Any] = field(default_factory=dict)
    watch: Callable[[Condition, VisitData], None] = lambda condition, measured: None

    def __post_init__(self) -> None:
        """Raise SettingError for an invalid number of echoes."""
        if not 1 <= self.echoes <= 17:
            raise SettingError(f"echoes must lie from 1 to 17, got {self.echoes}: a sonar has 17 echo registers")

    def run(self, progress: Progress | None = None) -> Path:
        """Measure the conditions that the recording does not contain yet.

        Args:
            progress: called after each condition with the number of recorded pings and the total.

        Returns:
            The path of the recording.

        Raises:
            RecordingError: the file exists and `resume` is False, it belongs to another plan, another process is
                writing it, or the disk is full or fails.
            NoAnswerError: the connection failed and the operator quit. Complete conditions are on disk in any case.
        """
        with Journal.open(self.path, self.plan.pings, self.resume) as journal:
            todo = self._todo(journal)
            journal.begin(self._all_settings())
            if todo:
                SurveyRun(self, journal, todo, progress).run()
            if journal.n_visits == len(self.plan):
                journal.finish()
        return self.path

    def _all_settings(self) -> dict[str, Any]:
        return {**asdict(self.plan), "echoes": self.echoes, "sensor": self.sensor, **self.settings}

    def _todo(self, journal: Journal) -> deque[int]:
        """Return the numbers of the conditions that the file does not contain."""
        if journal.table is None:
            return deque(range(len(self.plan)))
        self._check_echoes(journal.table)
        last = str(journal.table["session"].iloc[-1])
        if not last.isdecimal():
            raise RecordingError(f"{self.path}: session {last!r} of the last row is no whole number; correct that row")
        done = self._recorded(journal.table)
        due = {_key(condition): number for number, condition in enumerate(self.plan.conditions)}
        counted = Counter(done[:: self.plan.pings])
        for row, key in enumerate(done):
            if key not in due or key != done[row - row % self.plan.pings] or counted[key] > 1:
                raise RecordingError(
                    f"{self.path}, line {row + 2}: the condition is not the one of the plan; "
                    "resume with the original plan and number of pings"
                )
        return deque(sorted(set(due.values()) - {due[key] for key in counted}))

    def _check_echoes(self, table: pd.DataFrame) -> None:
        recorded = 1 + sum(ECHO_COLUMN.fullmatch(str(name)) is not None for name in table)
        if recorded != self.echoes:
            raise RecordingError(
                f"{self.path}: has {recorded} echoes per ping, this session {self.echoes}; give the same number"
            )

    def _recorded(self, table: pd.DataFrame) -> list[tuple[float, ...]]:
        """Return the rounded condition of each row."""
        names = [*CONDITION_QUANTITIES, *self.plan.sweep]
        missing = [name for name in names if name not in table]
        if missing:
            raise RecordingError(f"{self.path}, line 1: column {missing[0]} is missing; resume with the same plan")
        number = table[names].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
        return [tuple(row) for row in number.round(DIGITS).tolist()]


def _key(condition: Condition) -> tuple[float, ...]:
    """Return the values of a condition, rounded twice like those of a recording."""
    return tuple(np.round(list(condition.values.values()), 6).round(DIGITS).tolist())


@dataclass
class SurveyRun:
    """State of a running session.

    Attributes:
        session: the session.
        journal: its open file.
        todo: numbers of the remaining conditions.
        progress: see `Session.run`.
    """

    session: Session
    journal: Journal
    todo: deque[int]
    progress: Progress | None

    def __post_init__(self) -> None:
        """Set the session number; resumed hardware gets a new one, because time has passed."""
        table = self.journal.table
        last = 0 if table is None else int(table["session"].iloc[-1])
        self.number = last if table is None or self.session.source.simulated else last + 1
        self.last: int | None = None
        self.current: Condition | None = None
        self.n_silent = 0

    def run(self) -> None:
        """Test the connection, then measure the remaining conditions until the operator quits."""
        if self.journal.n_visits:
            self._report()  # start value, so that the estimated time ignores the conditions recorded before
        if self._test_sonar() is Answer.QUIT:
            return
        while self.todo:
            condition = self.session.plan.condition(self.todo[0])
            answer = self.session.operator.ready(self.current, condition, self.last is not None)
            if answer is Answer.GO:
                self.current = condition
                answer = self._measure()
            if answer is Answer.QUIT:
                return
            if answer is Answer.SKIP:
                self.todo.popleft()
            elif answer is Answer.REPEAT:
                self._undo_last()

    def _test_sonar(self) -> Answer:
        """Test the connection until the sonar answers and the operator accepts its echoes."""
        while True:
            try:
                has_echo = self.session.source.check()
            except NoAnswerError as error:
                if self.session.operator.unanswered(error) is not Answer.GO:
                    raise
                continue
            answer = Answer.SKIP if has_echo else self.session.operator.silent(0)
            if answer is not Answer.GO:
                return answer

    def _measure(self) -> Answer:
        """Measure and record the next condition; return how to continue."""
        try:
            measured = self.session.source.measure(self.session.plan, self.todo[0])
        except NoAnswerError as error:
            answer = self.session.operator.unanswered(error)
            if answer is Answer.QUIT:
                raise
            return answer
        self.journal.append(self._rows(measured))
        self.last = self.todo.popleft()
        self.session.watch(self.session.plan.condition(self.last), measured)
        self._report()
        return self._check_silence(measured.reading)

    def _report(self) -> None:
        if self.progress is not None:
            pings = self.session.plan.pings
            self.progress(self.journal.n_visits * pings, len(self.session.plan) * pings)

    def _check_silence(self, reading: Reading) -> Answer:
        """Let the operator test the sonar after `MAX_SILENT` conditions without echo."""
        self.n_silent = 0 if reading.echo.any() else self.n_silent + 1
        if self.n_silent < MAX_SILENT:
            return Answer.GO
        answer = self.session.operator.silent(self.n_silent)
        self.n_silent = 0
        answer = self._test_sonar() if answer is Answer.GO else answer
        return Answer.QUIT if answer is Answer.QUIT else Answer.GO

    def _undo_last(self) -> None:
        if self.last is not None:
            self.journal.drop_last()
            self.todo.appendleft(self.last)
            self.last = self.current = None  # the operator sets the condition up again

    def _rows(self, measured: VisitData) -> pd.DataFrame:
        reading = measured.reading
        echoes = np.zeros((len(reading), self.session.echoes - 1))
        recorded = reading.echoes[:, : self.session.echoes - 1]
        echoes[:, : recorded.shape[1]] = recorded
        table = Recording.of(measured.ping, Reading(reading.range, reading.status, echoes)).table
        names = {"session": str(self.number), "sensor": self.session.sensor}
        swept = dict(self.session.plan.condition(self.todo[0]).swept)
        logged: dict[str, Any] = {**names, **measured.columns, **swept}
        return table.assign(**logged)
