"""Let agents drive the same streets with each sonar, and say how often they park, with intervals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
from rich.console import Console
from rich.table import Table

import sonar_gym
from acquisition import SettingError
from acquisition.io.files import write_text
from sonar_gym.agent import AgentDriver, load_policy
from sonar_gym.control.driver import Driver, Episode, ParkingDriver, run_episode
from training.agents.evaluate import SCRIPTED, Outcomes, crew_of, evaluate
from training.agents.real import heard_as
from training.common.paired import Paired
from training.common.progress import bars
from training.diagnosis.demo_page import gif

EVERY = 3  # steps from picture to picture of a film


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym evaluate-agent`."""

    agent: tuple[str, ...] = ("parking", SCRIPTED)
    """Names or folders of agents; "scripted" is the driver written by hand. All are compared with the first."""
    sonars: tuple[str, ...] = ("ideal", "srf08-mlp")
    """Names or folders of the models to drive with."""
    believed: str | None = None
    """Name or folder of the model by which credence is reckoned: a car takes its sonar for the one that it was trained
    with, and "rig" knows none. By default each sonar's own."""
    odometry: str = "exact"
    """How far off the car's knowledge of its way is: exact, wheels, worn."""
    difficulty: str = "normal"
    """Of the streets: easy, normal, hard."""
    episodes: int = 500
    """Streets; the same for every agent and sonar."""
    seed: int = 0
    """Of the first street; the others follow. Below 2147483648 none of them was trained on."""
    out: Path | None = None
    """JSON file to write the numbers to."""
    film: Path | None = None
    """GIF to write of the first street, driven by the first agent with each sonar."""
    render: bool = False
    """Show the first agent on the first street in a window, with each sonar."""

    def __post_init__(self) -> None:
        """Refuse to evaluate nothing."""
        if self.episodes < 1 or not self.agent or not self.sonars:
            raise SettingError(f"give one episode or more ({self.episodes}), an agent and a sonar")
        if self.film is not None and self.film.suffix != ".gif":
            raise SettingError(f"--film {self.film}: must end with .gif")

    def world(self, sonar: str) -> dict[str, Any]:
        """Return the settings of the environment with a sonar."""
        heard = heard_as(sonar, self.believed)
        return {"sonar": heard, "odometry": self.odometry, "difficulty": self.difficulty}


Found = dict[tuple[str, str], Outcomes]  # by agent and sonar
Tell = Callable[[str, int, int], None]


def driver_of(name: str) -> Driver:
    """Return the driver of one car by an agent's name or folder."""
    return ParkingDriver() if name == SCRIPTED else AgentDriver(load_policy(name))


def compare(args: Args, tell: Tell = lambda what, done, of: None) -> Found:
    """Let every agent drive all streets with every sonar."""
    found: Found = {}
    crews = {name: crew_of(name if name == SCRIPTED else load_policy(name)) for name in args.agent}
    seeds, pooled = range(args.seed, args.seed + args.episodes), args.believed is not None
    for sonar in args.sonars:
        for name, crew in crews.items():
            what = f"{Path(name).name}, {Path(sonar).name}"
            found[name, sonar] = evaluate(crew, args.world(sonar), seeds, lambda k, n, w=what: tell(w, k, n), pooled)  # type: ignore[misc]
    return found


def table(args: Args, found: Found) -> Table:
    """Return the results as a table for the terminal."""
    last = args.seed + args.episodes - 1
    believed = "" if args.believed is None else f"credence of {Path(args.believed).name}; "
    title = f"streets {args.seed} to {last}, {args.difficulty}, odometry {args.odometry}; {believed}intervals at 95 %"
    out = Table(title=title)
    for heading in (
        "sonar",
        "agent",
        "parked",
        "touched something",
        "seconds",
        f"against {Path(args.agent[0]).name}, points",
    ):
        out.add_column(heading, justify="left" if heading in ("sonar", "agent") else "right")
    for (name, sonar), one in found.items():
        first = found[args.agent[0], sonar]
        change = "" if one is first else str(Paired.of(first.success, one.success))
        seconds = f"{0.1 * one.steps.mean():.1f}"
        out.add_row(Path(sonar).name, Path(name).name, str(one.successes), str(one.collisions), seconds, change)
    return out


def plain(args: Args, found: Found) -> list[dict[str, Any]]:
    """Return the results as plain data."""
    return [
        {
            "agent": name,
            "sonar": sonar,
            "episodes": len(one.seeds),
            "first_seed": args.seed,
            "believed": args.believed,
            "odometry": args.odometry,
            "difficulty": args.difficulty,
            "success": one.successes.share,
            "success_interval": one.successes.interval,
            "collision": one.collisions.share,
            "collision_interval": one.collisions.interval,
            "mean_seconds": 0.1 * float(one.steps.mean()),
            "failed_seeds": one.seeds[~one.success].tolist(),
        }
        for (name, sonar), one in found.items()
    ]


def drive(args: Args, sonar: str, mode: str) -> Episode:
    """Drive the first street by the first agent, in pictures."""
    env = gymnasium.make(sonar_gym.ENV_ID, render_mode=mode, **args.world(sonar))
    try:
        return run_episode(env, driver_of(args.agent[0]), args.seed, every=EVERY)
    finally:
        env.close()


def main(args: Args) -> None:
    """Evaluate, print the table, write what was asked for."""
    with bars() as progress:
        tasks: dict[str, Any] = {}

        def tell(what: str, done: int, of: int) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=of)
            progress.update(tasks[what], completed=done)

        found = compare(args, tell)
    Console(soft_wrap=True).print(table(args, found))
    if args.out is not None:
        write_text(args.out, json.dumps(plain(args, found), indent=2) + "\n")
    if args.film is not None:
        gif({Path(sonar).name: drive(args, sonar, "rgb_array").frames for sonar in args.sonars}, args.film)
    if args.render:
        for sonar in args.sonars:
            drive(args, sonar, "human")
