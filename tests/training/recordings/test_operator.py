"""The operator's dialogue: questions and answers."""

import io
from dataclasses import replace

import pytest
from rich.console import Console
from rich.progress import Progress

from acquisition import NoAnswerError
from acquisition.survey.plan import PLANS, Condition
from acquisition.survey.session import Answer
from training.recordings.operator import TerminalOperator, changes
from training.recordings.record import effort

CONDITION = Condition(500.0, 10.0, 0.9, 0.0, (("gain", 3.0), ("height_mm", 1500.0)))


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
        return TerminalOperator(console, Progress(console=console, disable=True)), out

    return make


def test_the_first_condition_is_described_in_full_in_mm_and_degrees(ask):
    operator, out = ask("")
    assert operator.ready(None, CONDITION, False) is Answer.GO
    text = out.getvalue()
    assert "Set up: distance 500 mm" in text
    assert "bearing of the reflector 10 deg" in text
    assert "height of sensor and reflector above the floor 1500 mm" in text
    assert "gain" not in text  # a register of the sonar
    assert "r repeat the previous one" not in text


def test_later_conditions_list_changes_only():
    assert changes(CONDITION, replace(CONDITION, distance_mm=750.0)) == ["Move: distance 500 mm -> 750 mm"]
    both = changes(CONDITION, replace(CONDITION, angle_deg=22.5, reflectance=0.1))
    assert both == ["Move: bearing of the reflector 10 deg -> 22.5 deg", "Move: reflectance 0.9 -> 0.1"]


def test_without_changes_by_hand_there_is_no_question(ask):
    operator, out = ask()
    assert (
        operator.ready(CONDITION, replace(CONDITION, swept=(("gain", 4.0), ("height_mm", 1500.0))), True) is Answer.GO
    )
    assert out.getvalue() == ""


@pytest.mark.parametrize(
    ("given", "answer"),
    [("", Answer.GO), ("s", Answer.SKIP), (" R ", Answer.REPEAT), ("q", Answer.QUIT)],
)
def test_every_key_is_an_answer(ask, given, answer):
    operator, _ = ask(given)
    assert operator.ready(CONDITION, replace(CONDITION, distance_mm=750.0), True) is answer


def test_an_invalid_answer_repeats_the_question_and_the_end_of_input_quits(ask):
    operator, out = ask("x", "r")
    assert operator.ready(None, CONDITION, False) is Answer.QUIT  # there is nothing to repeat yet
    assert out.getvalue().count("is not one of these keys") == 2


def test_no_answer_and_no_echo_are_different_questions(ask):
    operator, out = ask("", "s", "q")
    assert operator.unanswered(NoAnswerError("SRF08 at 0x70: no acknowledge")) is Answer.GO
    assert operator.silent(5) is Answer.SKIP
    assert operator.silent(0) is Answer.QUIT
    text = out.getvalue()
    assert "NO ANSWER. SRF08 at 0x70: no acknowledge. This condition is not recorded." in text
    assert "receives no echo in 5 consecutive conditions. Hold a hand 20 to 50 cm in front of it." in text


def test_the_work_by_hand_is_estimated():
    assert effort(PLANS["gain-sweep"]) == "128 conditions, 2560 pings, about 0.8 h; 4 moves by hand over 2 m"
    text = effort(PLANS["thesis"])
    assert text.startswith("2662 conditions, 133100 pings, about 101.7 h; 26")
    assert text.endswith("(--order walk: 131 m)")
