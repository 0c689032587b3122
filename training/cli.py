"""The console command `sonar-gym`: one subcommand a module, each with a frozen `Args` dataclass and a `main`."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import tyro

from acquisition import MissingExtraError, SonarError
from acquisition.name_check import check_noise

# subcommand -> (module under `training` with `Args` and `main(args)`, what it does); imported only when it runs,
# so that recording on a small machine needs none of the heavy packages
COMMANDS = {
    "demo": ("training.diagnosis.demo", "the whole chain in three minutes: record, diagnose, correct, drive"),
    "record": (
        "training.recordings.record",
        "record a survey with a sonar, or with the waveform rig where there is none",
    ),
    "import": ("training.recordings.import_log", "turn a log of another program into a recording"),
    "plot": ("training.recordings.plot", "draw a recording: credence surfaces, detection, readings, course of time"),
    "train-noise": ("training.noise.train", "train a noise model on a recording"),
    "train-agent": ("training.agents.train", "train an agent that parks, with the sonars that you choose"),
    "evaluate-agent": (
        "training.agents.evaluate_agent",
        "let agents drive the same streets, and say how often they park",
    ),
    "make-noise": ("training.noise.make", "make the shipped noise models again"),
    "noise-report": ("training.noise.report", "write the page that puts all noise models side by side"),
    "ship-agent": ("training.agents.ship", "score an agent on unseen streets, and write it out with its card"),
    "sweep": ("training.agents.sweep", "train agents of many seeds and settings on Ray Tune, on one machine or many"),
    "transfer": ("training.agents.transfer", "train agents with several sonars, and test all of them in the rig"),
    "compare-noise": ("training.noise.compare", "score noise models beside baselines on recordings of other sensors"),
    "compare-optimizers": ("training.thesis.compare_optimizers", "train the thesis's networks, beside its own tables"),
    "compare-thesis": ("training.thesis.compare_thesis", "hold the rig against the networks of the thesis's own sonar"),
    "compare-drivers": (
        "training.agents.compare_drivers",
        "park with ideal and real sonars, with and without credence",
    ),
    "diagnose": (
        "training.diagnosis.diagnose",
        "say where a simulation and a recording differ, why, and correct the model",
    ),
    "prove": (
        "training.diagnosis.prove",
        "blind trials of the diagnosis on concealed effects: sealed, scored, published",
    ),
    "prove-real": ("training.diagnosis.prove_real", "diagnose real recordings with a column of theirs hidden"),
    "effects": ("training.diagnosis.effects", "list the effects that a diagnosis can name"),
}
USAGE_ERROR, INTERRUPTED = 2, 130


def main(argv: Sequence[str] | None = None) -> None:
    """Run one subcommand; what a user can mend is told in one line on stderr, with exit code 2."""
    argv = list(sys.argv[1:] if argv is None else argv)
    if not argv or argv[0] in ("-h", "--help"):
        print(overview())
    elif argv[0] == "--version":
        print(f"sonar-gym {version('sonar-gym')}")
    elif argv[0] not in COMMANDS:
        _stop(f"{argv[0]!r} is no command; there are {', '.join(COMMANDS)}. `sonar-gym --help` tells what they do")
    else:
        _run(argv[0], argv[1:])


def overview() -> str:
    """Return what the commands do, a line each."""
    lines = [f"  {name:<19} {summary}" for name, (_, summary) in COMMANDS.items()]
    head = "sonar-gym: real sonar for simulated robots\n\nusage: sonar-gym COMMAND [options]\n\ncommands:"
    return "\n".join([head, *lines, "\n`sonar-gym COMMAND --help` lists the options of each."])


def _run(name: str, argv: Sequence[str]) -> None:
    try:
        check_noise()
        module = _load(name)
        args = tyro.cli(module.Args, prog=f"sonar-gym {name}", description=module.__doc__, args=argv)
        module.main(args)
    except SonarError as error:
        _stop(str(error))
    except KeyboardInterrupt:
        print("sonar-gym: interrupted; what was written before is whole", file=sys.stderr)
        raise SystemExit(INTERRUPTED) from None


def _load(name: str) -> Any:  # a module with Args and main
    try:
        return importlib.import_module(COMMANDS[name][0])
    except ModuleNotFoundError as error:
        hint = "pip install 'sonar-gym[all]'"
        raise MissingExtraError(f"`sonar-gym {name}` needs the package {error.name!r}: {hint}") from None


def _stop(message: str) -> None:
    print(f"sonar-gym: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(USAGE_ERROR)


if __name__ == "__main__":
    main()
