"""Score an agent on unseen streets of every kind, and save it with its card."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from string import Template
from textwrap import fill
from typing import Annotated, Any

import tyro
from annotated_types import MinLen
from pydantic import ConfigDict

from acquisition import ModelError
from acquisition.io.places import Output
from acquisition.io.schema import Schema, validated
from acquisition.limits import Count, Seed
from noise.store import ModelName
from sonar_gym.agent import WEIGHTS, Policy, load_policy
from sonar_gym.sensing.odometry import OdometryName
from sonar_gym.street.street import Difficulty
from training.agents.evaluate import Outcomes, evaluate, pool_of
from training.agents.sonars import has_probabilities, mismatched
from training.common.progress import bar
from training.common.tables import markdown_table

CARD = Path(__file__).parent / "templates" / "agent_card.md"
LIMITS = (
    'The agent is made for eight sonars (layout "eight"), for this car, and for these streets. '
    "Its memory measures distance by odometry, so worn wheels reduce its success."
)
WITH_FAULTS = (
    "Half of the cars in training had sonars with faults: 5 % of readings arbitrary, 10 % with 50 mm of scatter. "
    "It was not trained with larger faults."
)
WITHOUT_FAULTS = "It was trained with the sonars above only, and without faults."
WIDTH = 120
MAX_LEGS = 6  # legs of the training that the card lists
SCENARIO = ("sonar", "odometry", "difficulty")
SETTINGS = ("sonars", "odometry", "difficulty")
Scenario = tuple[str, str, str]


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym ship-agent`."""

    agent: Annotated[Path, tyro.conf.Positional]
    """Folder of a trained agent."""
    out: Annotated[Path, Output("folder", "agent.json")] = WEIGHTS / "parking"
    """Folder for the agent and its card."""
    sonars: Annotated[tuple[ModelName, ...], MinLen(1)] = ("ideal", "srf08-mlp", "rig")
    """Names of the sonar models."""
    believed: ModelName = "srf08-mlp"
    """Name of the model from which credence is computed with a sonar model without probabilities, such as the rig."""
    odometry: Annotated[tuple[OdometryName, ...], MinLen(1)] = ("exact", "wheels")
    """Errors of the odometry: exact, wheels, worn."""
    difficulty: Annotated[tuple[Difficulty, ...], MinLen(1)] = ("normal", "hard")
    """Difficulties of the streets: easy, normal, hard, manoeuvre."""
    episodes: Count = 500
    """Number of streets for each combination."""
    seed: Seed = 0
    """Seed of the first street."""


class _Record(Schema):
    """A part of a training record; further fields are not looked at."""

    model_config = ConfigDict(extra="allow")


class _Settings(_Record):
    sonars: list[str]
    odometry: list[str]
    difficulty: list[str]
    faults: bool
    lessons: int
    num_envs: int
    seed: int


class _Leg(_Record):
    leg: int
    steps: int
    success: float
    collision: float
    seconds_an_episode: float


class _Training(_Record):
    settings: _Settings
    steps: int
    planned: int
    history: Annotated[list[_Leg], MinLen(1)]


def command(settings: dict[str, Any], steps: int, out: str) -> str:
    """Return the command line that trains an agent with given settings."""
    words = ["sonar-gym", "train-agent", "--out", out]
    for name, value in {**settings, "steps": steps}.items():
        if isinstance(value, bool):
            words.append(f"--{name}" if value else f"--no-{name}")
        else:
            words += [f"--{name.replace('_', '-')}", *map(str, value if isinstance(value, list) else [value])]
    return shlex.join(words)


def card(name: str, policy: Policy, scores: dict[Scenario, Outcomes], commands: Sequence[str], assumed: str) -> str:
    """Return the card of an agent, in Markdown.

    Args:
        name: name of the agent.
        policy: policy with the settings and history of its training.
        scores: results by scenario, all on the same streets.
        commands: commands that reproduce the agent, in order.
        assumed: name of the model from which credence is computed where a sonar model has no probabilities.
    """
    settings, history = policy.about["settings"], list(policy.about["history"])
    streets = next(iter(scores.values())).seeds
    return Template(CARD.read_text(encoding="utf-8")).substitute(
        name=name,
        sizes=" - ".join(map(str, policy.sizes)),
        hold=f"{0.1 * policy.repeat:g}",
        cars=settings["num_envs"],
        kinds="\n".join(f"- {setting}: {', '.join(settings[setting])}" for setting in SETTINGS),
        learned=fill(_learned(settings["lessons"], policy.about["steps"], policy.about["planned"]), WIDTH),
        limits=fill(f"{LIMITS} {WITH_FAULTS if settings['faults'] else WITHOUT_FAULTS}", WIDTH),
        assumed=assumed,
        course=_course(_some(history)),
        seed=settings["seed"],
        commands="\n".join(f"    {line}" for line in commands),
        first=streets[0],
        last=streets[-1],
        scores=_scores(scores),
    )


def _learned(rounds: int, done: int, planned: int) -> str:
    imitation = f"Imitation (DAgger): a teacher that knows the true state labelled {rounds} decisions of each car"
    ppo = f"PPO for {_steps(done, planned)}"
    if not rounds:
        return f"{ppo}, without imitation."
    return f"{imitation}; then {ppo}." if done else f"{imitation}. No reinforcement learning."


def _steps(done: int, planned: int) -> str:
    stopped = f" (stopped before the planned {planned:,})" if done < planned else ""
    return f"{done:,} steps of 0.1 s{stopped}"


def _some(history: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the first leg, the last, and some between."""
    places = {round(k * (len(history) - 1) / (MAX_LEGS - 1)) for k in range(MAX_LEGS)}
    return [history[k] for k in sorted(places)]


def _course(history: list[dict[str, Any]]) -> str:
    header = ("after", "steps of PPO", "parked", "collided", "seconds per episode")
    return markdown_table(header, map(_leg, history))


def _leg(one: dict[str, Any]) -> tuple[object, ...]:
    phase = "imitation" if one["leg"] == 0 else f"leg {one['leg']}"
    rates = (f"{100 * one['success']:.1f} %", f"{100 * one['collision']:.1f} %")
    return phase, one["steps"], *rates, f"{one['seconds_an_episode']:.1f}"


def _scores(scores: dict[Scenario, Outcomes]) -> str:
    rows = ((*scenario, one.successes, one.collisions, f"{one.mean_seconds:.1f}") for scenario, one in scores.items())
    return markdown_table((*SCENARIO, "parked", "collided", "seconds"), rows)


def main(args: Args) -> None:
    """Score the agent, write its card, and save it."""
    policy, scores = load_policy(args.agent), dict[Scenario, Outcomes]()
    validated(dict(policy.about), _Training, f"{args.agent}, training record", ModelError)
    scenarios = list(product(args.sonars, args.odometry, args.difficulty))
    seeds = range(args.seed, args.seed + args.episodes)
    with bar("scoring", len(scenarios)) as on_progress:
        for k, scenario in enumerate(scenarios):
            name = scenario[0]
            sonar = name if has_probabilities(name) else mismatched(name, args.believed)
            settings = {**dict(zip(SCENARIO, scenario, strict=True)), "sonar": sonar}
            scores[scenario] = evaluate(pool_of(policy), settings, seeds, pooled=sonar is not name)
            on_progress(k + 1, len(scenarios))
    train_command = command(policy.about["settings"], policy.about["planned"], "run")
    commands = [train_command, f"sonar-gym ship-agent run/agent --out {args.out.name}"]
    replace(policy, card=card(args.out.name, policy, scores, commands, args.believed)).save(args.out)
    print(f"{args.out}: saved; load it with sonar_gym.agent.load_agent({args.out.name!r})")
