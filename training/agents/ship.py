"""Make an agent ready to be shipped: score it on unseen streets of every kind, write its card, put it into a folder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import tyro

from sonar_gym.agent import WEIGHTS, load_policy
from training.agents.card import World, card, command
from training.agents.evaluate import Outcomes, crew_of, evaluate
from training.agents.real import heard_as, tells
from training.common.progress import bar


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym ship-agent`."""

    agent: Annotated[Path, tyro.conf.Positional]
    """Folder of a trained agent."""
    out: Path = WEIGHTS / "parking"
    """Folder to write it to, with its card."""
    sonars: tuple[str, ...] = ("ideal", "srf08-mlp", "rig")
    """Names of the sonars to score it with."""
    believed: str = "srf08-mlp"
    """Name of the model by which credence is reckoned with a sonar that knows no probabilities, as the rig."""
    odometry: tuple[str, ...] = ("exact", "wheels")
    """Kinds of odometry to score it with."""
    difficulty: tuple[str, ...] = ("normal", "hard")
    """Kinds of street to score it in."""
    episodes: int = 500
    """Streets of each kind."""
    seed: int = 0
    """Of the first street."""


def main(args: Args) -> None:
    """Score, write the card, save."""
    policy, scores = load_policy(args.agent), dict[World, Outcomes]()
    kinds = list(product(args.sonars, args.odometry, args.difficulty))
    seeds = range(args.seed, args.seed + args.episodes)
    with bar("scoring", len(kinds)) as tell:
        for k, (sonar, odometry, difficulty) in enumerate(kinds):
            heard = sonar if tells(sonar) else heard_as(sonar, args.believed)
            world = {"sonar": heard, "odometry": odometry, "difficulty": difficulty}
            scores[sonar, odometry, difficulty] = evaluate(crew_of(policy), world, seeds, pooled=heard is not sonar)
            tell(k + 1, len(kinds))
    made_by = command(policy.about["settings"], policy.about["planned"], "run")
    commands = [made_by, f"sonar-gym ship-agent run/agent --out {args.out.name}"]
    replace(policy, card=card(args.out.name, policy, scores, commands, args.believed)).save(args.out)
    print(f"{args.out}: saved; load it with sonar_gym.agent.load_agent({args.out.name!r})")
