"""What is told of a trained agent: its card."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from string import Template
from textwrap import fill
from typing import Any

from sonar_gym.agent import Policy
from training.agents.evaluate import Outcomes

CARD = Path(__file__).parent / "templates" / "agent_card.md"
LIMITS = (
    'It was made for eight sonars (layout "eight"), for this car, and for these streets. '
    "Its memory counts the way by odometry, so worn wheels make it worse."
)
HARDENED = (
    "Half of its cars had sonars of which 5 % of readings told of things that were not there and 10 % scattered by "
    "50 mm; a sonar that errs more, it has not met."
)
PLAIN = "It has met no sonar but those above, and none that errs more."
WIDTH = 120
LEGS = 6  # of the course of training that are told
World = tuple[str, str, str]  # sonar, odometry, difficulty
PARTS = ("sonars", "odometry", "difficulty")


def command(settings: dict[str, Any], steps: int, out: str) -> str:
    """Return the command line that trains an agent of such settings."""
    words = ["sonar-gym", "train-agent", "--out", out]
    for name, value in {**settings, "steps": steps}.items():
        if isinstance(value, bool):
            words.append(f"--{name}" if value else f"--no-{name}")
        else:
            words += [f"--{name.replace('_', '-')}", *map(str, value if isinstance(value, list) else [value])]
    return shlex.join(words)


def card(name: str, policy: Policy, scores: dict[World, Outcomes], commands: Sequence[str], believed: str) -> str:
    """Return the card of an agent, in Markdown.

    Args:
        name: of the agent.
        policy: as training wrote it, with its settings and its course.
        scores: by sonar, odometry and difficulty, all on the same streets.
        commands: that make it again, in order.
        believed: name of the model by which credence was reckoned where a sonar knows none.
    """
    settings, history = policy.about["settings"], list(policy.about["history"])
    streets = next(iter(scores.values())).seeds
    return Template(CARD.read_text(encoding="utf-8")).substitute(
        name=name,
        sizes=" - ".join(map(str, policy.sizes)),
        hold=f"{0.1 * policy.repeat:g}",
        cars=settings["num_envs"],
        worlds="\n".join(f"- {part}: {', '.join(settings[part])}" for part in PARTS),
        learned=fill(_learned(settings["lessons"], policy.about["steps"], policy.about["planned"]), WIDTH),
        limits=fill(f"{LIMITS} {HARDENED if settings['faults'] else PLAIN}", WIDTH),
        believed=believed,
        course="\n".join(map(_leg, _some(history))),
        seed=settings["seed"],
        commands="\n".join(f"    {line}" for line in commands),
        first=streets[0],
        last=streets[-1],
        scores="\n".join(_score(*item) for item in scores.items()),
    )


def _learned(lessons: int, done: int, planned: int) -> str:
    taught = (
        f"Its teacher, which knows the truth, commented on {lessons} of its decisions in each car (dataset aggregation)"
    )
    tried = f"it learned by trial for {_steps(done, planned)} (PPO)"
    if not lessons:
        return f"{tried[0].upper()}{tried[1:]}, from nothing."
    return f"{taught}; then {tried}." if done else f"{taught}, and that is all: it did not learn by trial."


def _steps(done: int, planned: int) -> str:
    ended = f" (and was stopped there, of {planned:,} planned)" if done < planned else ""
    return f"{done:,} steps of 0.1 s{ended}"


def _some(history: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the first leg, the last, and some between."""
    places = {round(k * (len(history) - 1) / (LEGS - 1)) for k in range(LEGS)}
    return [history[k] for k in sorted(places)]


def _leg(one: dict[str, Any]) -> str:
    what = "imitation" if one["leg"] == 0 else f"leg {one['leg']}"
    shares = f"{100 * one['success']:.1f} % | {100 * one['collision']:.1f} %"
    return f"| {what} | {one['steps']} | {shares} | {one['seconds_an_episode']:.1f} |"


def _score(world: World, one: Outcomes) -> str:
    seconds = f"{0.1 * one.steps.mean():.1f}"
    return f"| {' | '.join([*world, str(one.successes), str(one.collisions), seconds])} |"
