"""The console command `sonar-gym`: one module per subcommand, each with a frozen `Args` dataclass and a `main`."""

from __future__ import annotations

import contextlib
import importlib
import io
import sys
from collections.abc import Sequence
from typing import Any

import tyro
import tyro.extras

from acquisition import MissingExtraError, SettingError
from acquisition.io.places import check_places
from acquisition.limits import check_settings, near, shown
from acquisition.name_check import ForeignNameError, check_names, foreign
from acquisition.version import __version__
from training.common.door import door, parsing

# group -> subcommand -> (module below `training` with `Args` and `main(args)`, summary). A module is imported only when
# its command runs, so that recording on a small machine needs none of the heavy packages.
GROUPS = {
    "use": {
        "demo": ("diagnosis.demo", "record with a concealed effect, diagnose, correct, and park; three minutes"),
        "record": ("recordings.record", "record a survey with a sonar or with the simulated waveform rig"),
        "import": ("recordings.import_log", "convert the log of another program into a recording"),
        "plot": ("recordings.plot", "plot a recording: credence, detection, readings, readings over time"),
        "diagnose": (
            "diagnosis.diagnose",
            "find where a simulation and a recording differ, and why; correct the model",
        ),
        "correct": ("recordings.correct", "apply what a diagnosis found to the readings of the simulator"),
        "train-noise": ("noise.train", "train a noise model on a recording"),
        "train-agent": ("agents.train", "train a parking agent with the sonar models you choose"),
        "evaluate-agent": ("agents.evaluate", "measure how often agents park in the same streets"),
        "zoo": ("agents.zoo.command", "train a plain algorithm with tuned settings and test it on unseen streets"),
        "dataset": ("agents.dataset", "write episodes of drivers as datasets of Minari for offline learning"),
        "sweep": ("agents.sweep", "train agents with many seeds and settings on Ray Tune"),
        "effects": ("pages.effects", "list the effects that a diagnosis can name"),
        "view": ("pages.view", "write a page of a folder of results, for the browser"),
    },
    "other programs": {
        "bridge": ("bridges.bridge", "connect to OpenDLV, ROS and Webots: sonars, a car, an agent, files"),
        "serve": ("bridges.serve", "answer other programs' pings over TCP"),
        "export": ("bridges.export", "write a unit of FMI 3.0, or the nearest sonar that Webots or Gazebo can hold"),
    },
    "evidence": {
        "prove": ("proof.run", "run blind trials of the diagnosis: sealed, scored, published"),
        "verify-proof": ("proof.verify", "verify the ledger of such trials"),
        "judge": ("diagnosis.judging.command", "measure the diagnosis on labelled trials and on real recordings"),
        "transfer": ("agents.transfer", "train agents with several sonar models and test all of them in the rig"),
        "leaderboard": (
            "agents.leaderboard.command",
            "score drivers on hard streets with damaged sonars",
        ),
        "compare-noise": ("noise.compare", "score noise models and baselines on recordings of other sensors"),
        "compare-drivers": ("agents.compare_drivers", "park with ideal and noisy sonars, with and without credence"),
        "compare-observations": (
            "agents.compare_observations",
            "train agents with and without credence and echo flags, and test them in the rig",
        ),
        "compare-optimizers": ("thesis.compare_optimizers", "train the thesis's networks and compare with its tables"),
        "compare-thesis": ("thesis.compare_thesis", "compare the rig with the networks published with the thesis"),
        "noise-report": ("noise.report", "write the page that compares all noise models"),
    },
    "make what is shipped": {
        "make-noise": ("noise.make", "train the shipped noise models again"),
        "make-credence": (
            "agents.credence",
            "count the credence of the shipped models on the registered streets again",
        ),
        "ship-agent": ("agents.ship", "score an agent on unseen streets and write it with its card"),
        "generate-trials": (
            "diagnosis.generators.command",
            "write labelled pairs of a simulation and a recording",
        ),
        "fit-decision": ("diagnosis.judging.fit_command", "fit the probabilities of causes on labelled trials"),
    },
}
COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}
COMPLETION = "completion"
SPECIFICATION = "COMPLETION_SPEC = "  # the line of the script that holds commands, options and descriptions
SHELLS = ("bash", "zsh", "fish")
ZSH_CALL = '\n_tyro_sonar_gym "$@"\n'  # which fails where the script is sourced, not completed from
ZSH_CALL_OR_SOURCED = (
    '\nif [ "$funcstack[1]" = "_sonar-gym" ]; then _tyro_sonar_gym "$@"; else compdef _tyro_sonar_gym sonar-gym; fi\n'
)
FOOT = """`sonar-gym COMMAND --help` lists the options of each; --debug shows the traceback of a failure.
`sonar-gym --version`; `sonar-gym completion bash|zsh|fish` prints a script for the shell."""
DEBUG = "--debug"  # of every command: shows the traceback of a failure


def main(argv: Sequence[str] | None = None) -> None:
    """Run one subcommand. A failure is one line on stderr; exit code 2 if the user can correct it, else 1."""
    given = list(sys.argv[1:] if argv is None else argv)
    argv = [word for word in given if word != DEBUG]
    with door(given, debug=DEBUG in given):
        if not argv or argv[0] in ("-h", "--help"):
            print(overview())
        elif argv[0] == "--version":
            print(f"sonar-gym {__version__}")
        elif argv[0] == COMPLETION:
            print(completion(argv[1:]))
        elif argv[0] not in COMMANDS:
            hint = near(argv[0], [*COMMANDS, COMPLETION]) or f"; commands: {', '.join(COMMANDS)}"
            raise SettingError(f"{shown(argv[0])} is not a command{hint} See `sonar-gym --help`")
        else:
            _run(argv[0], argv[1:])


def overview() -> str:
    """Return the help text: one line per command, by group."""
    head = "sonar-gym: realistic sonar for simulated robots\n\nusage: sonar-gym COMMAND [options]"
    width = max(map(len, COMMANDS))
    blocks = [
        "\n".join([f"{title}:", *(f"  {name:<{width}}  {summary}" for name, (_, summary) in group.items())])
        for title, group in GROUPS.items()
    ]
    return "\n\n".join([head, *blocks, FOOT])


def completion(argv: Sequence[str]) -> str:
    """Return the script by which a shell completes commands and options; commands that lack an extra are left out.

    Raises:
        SettingError: not the name of one shell.
    """
    if len(argv) != 1 or argv[0] not in SHELLS:
        raise SettingError(f"{COMPLETION}: expected one shell of {', '.join(SHELLS)}, got {shown(' '.join(argv))}")
    settings = {}
    for name in COMMANDS:
        with contextlib.suppress(MissingExtraError):
            settings[name] = _load(name).Args
    script = io.StringIO()
    with contextlib.redirect_stdout(script), contextlib.suppress(SystemExit):
        tyro.extras.subcommand_cli_from_dict(settings, prog="sonar-gym", args=["--tyro-print-completion", argv[0]])
    lines = script.getvalue().replace(ZSH_CALL, ZSH_CALL_OR_SOURCED).splitlines(keepends=True)
    return "".join(_described(line) if line.startswith(SPECIFICATION) else line for line in lines)


def _described(specification: str) -> str:
    """Give each command its summary, of which tyro knows the name alone; a shell takes each line for a completion."""
    for name, (_, summary) in COMMANDS.items():
        entry, quoted = f"'{name}': {{'description': ", summary.replace("'", r"\'")
        specification = specification.replace(f"{entry}'{name}'", f"{entry}'{quoted}'")
    return specification.replace(r"\n", " ")


def _run(name: str, argv: Sequence[str]) -> None:
    check_names()
    args = settings_of(name, argv)
    check_settings(args, lambda field: f"--{field.replace('_', '-')}")
    check_places(args)
    _load(name).main(args)


def settings_of(name: str, argv: Sequence[str]) -> Any:
    """Return the `Args` of a command from the words after it; values are not checked yet."""
    module = _load(name)
    with parsing(name):
        return tyro.cli(module.Args, prog=f"sonar-gym {name}", description=module.__doc__, args=argv)


def _load(name: str) -> Any:  # a module with Args and main
    try:
        return importlib.import_module(f"training.{COMMANDS[name][0]}")
    except ModuleNotFoundError as error:
        if (reason := foreign()) is not None:
            raise ForeignNameError(reason) from None
        hint = "pip install 'sonar-gym[all]'"
        raise MissingExtraError(f"`sonar-gym {name}` needs the package {error.name!r}: {hint}") from None


if __name__ == "__main__":
    main()
