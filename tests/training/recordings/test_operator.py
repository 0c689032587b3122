"""The wizard: what it asks, and what each answer means."""

import io
from dataclasses import replace

import pytest
from rich.console import Console
from rich.progress import Progress

from acquisition import NoAnswerError
from acquisition.survey.plan import PLANS, Cell
from acquisition.survey.session import Answer
from training.recordings.operator import Asking, changes
from training.recordings.record import effort

HERE = Cell(500.0, 10.0, 0.9, 0.0, (("gain", 3.0), ("height_mm", 1500.0)))


@pytest.fixture
def ask(monkeypatch):
    """Return an operator with prepared answers, and what was printed."""

    def make(*answers):
        given, out = list(answers), io.StringIO()
        console = Console(file=out, width=200)

        def read(prompt="", **_):
            console.print(prompt, markup=False)
            if not given:
                raise EOFError
            return given.pop(0)

        monkeypatch.setattr(console, "input", read)
        return Asking(console, Progress(console=console, disable=True)), out

    return make


def test_the_first_cell_is_told_in_full_in_mm_and_degrees(ask):
    operator, out = ask("")
    assert operator.ready(None, HERE, False) is Answer.GO
    told = out.getvalue()
    assert "Set up: distance 500 mm" in told
    assert "bearing of the reflector 10 deg" in told
    assert "height of sensor and reflector over the floor 1500 mm" in told
    assert "gain" not in told  # the sonar is told that over its wire
    assert "r the one before again" not in told


def test_later_cells_tell_only_what_changes():
    assert changes(HERE, replace(HERE, distance_mm=750.0)) == ["Move: distance 500 mm -> 750 mm"]
    both = changes(HERE, replace(HERE, angle_deg=22.5, reflectance=0.1))
    assert both == ["Move: bearing of the reflector 10 deg -> 22.5 deg", "Move: reflectance 0.9 -> 0.1"]


def test_nobody_is_asked_where_nothing_has_to_be_moved(ask):
    operator, out = ask()
    assert operator.ready(HERE, replace(HERE, swept=(("gain", 4.0), ("height_mm", 1500.0))), True) is Answer.GO
    assert out.getvalue() == ""


@pytest.mark.parametrize(
    ("given", "answer"),
    [("", Answer.GO), ("s", Answer.SKIP), (" R ", Answer.REPEAT), ("q", Answer.QUIT)],
)
def test_every_key_is_an_answer(ask, given, answer):
    operator, _ = ask(given)
    assert operator.ready(HERE, replace(HERE, distance_mm=750.0), True) is answer


def test_what_is_no_answer_is_asked_again_and_the_end_of_input_stops(ask):
    operator, out = ask("x", "r")
    assert operator.ready(None, HERE, False) is Answer.QUIT  # there is nothing to repeat yet
    assert out.getvalue().count("is none of these") == 2


def test_a_dead_wire_and_a_deaf_sonar_are_told_apart(ask):
    operator, out = ask("", "s", "q")
    assert operator.unanswered(NoAnswerError("SRF08 at 0x70: no acknowledge")) is Answer.GO
    assert operator.silent(5) is Answer.SKIP
    assert operator.silent(0) is Answer.QUIT
    told = out.getvalue()
    assert "NO ANSWER. SRF08 at 0x70: no acknowledge. This condition is not written down." in told
    assert "hears nothing for 5 conditions in a row. Hold a hand 20 to 50 cm before it." in told


def test_work_by_hand_is_told_before_it_begins():
    assert effort(PLANS["gain-sweep"]) == "128 conditions, 2560 pings, about 0.8 h; 4 moves by hand over 2 m"
    told = effort(PLANS["thesis"])
    assert told.startswith("2662 conditions, 133100 pings, about 101.7 h; 26")
    assert told.endswith("(--order walk: 131 m)")
