"""Diagnosis of the differences between a simulation and a recording, as an HTML report and a JSON verdict."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

import tyro

from acquisition import Recording, SettingError
from acquisition.io.places import Output
from acquisition.limits import Seed
from noise.discrepancy import diagnose
from noise.discrepancy.inputs import Progress, Simulator, as_model
from noise.discrepancy.result import Diagnosis
from sonar_gym.bridges.server.client import address_of, simulator_at
from training.common.progress import bars


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym diagnose`."""

    recorded: Annotated[Path, tyro.conf.Positional]
    """Recording of the real sonar (CSV, one row per ping)."""
    out: Annotated[Path, Output("folder", "verdict.json")]
    """Output folder: verdict.json, report.html and, where a correction is offered, the corrected model in corrected/;
    what acts on the simulator's own readings is in difference/ (`sonar-gym correct`)."""
    model: str = "ideal"
    """Model of the simulation: a name (ideal, gaussian, ...) or the folder of a saved model."""
    simulated: Path | None = None
    """Simulator in place of the model: its readings in the recording format; module:function, which is called as
    function(pings, rng) and returns readings; or tcp://HOST:PORT of a server that answers pings
    (docs/how-to/simulators.md)."""
    seed: Seed = 0
    """Seed; the same seed gives the same verdict."""


def main(args: Args) -> None:
    """Diagnose, write the output folder, print the verdict."""
    print("\n".join(summary(examine(args), args.out)))


def examine(args: Args) -> Diagnosis:
    """Diagnose and write the output folder."""
    recorded = Recording.load(args.recorded)
    simulator = None if args.simulated is None else simulator_of(args.simulated)
    simulated = None if args.simulated is None or simulator is not None else Recording.load(args.simulated)
    model = simulator or as_model(args.model)
    _check_out(args.out)
    with _progress() as update:
        diagnosis = diagnose(model, recorded, simulated=simulated, seed=args.seed, progress=update)
        update("drawing the report", 0.97)
        diagnosis.save(args.out)
        diagnosis.report(args.out / "report.html", args.seed)
    return diagnosis


def simulator_of(given: Path) -> Simulator | None:
    """Return the function `module:function`, also from the working directory, or one that asks the server tcp://...

    Returns:
        The function; None if a file is given.

    Raises:
        SettingError: the module cannot be imported, the function does not exist, or it is no address.
    """
    server = address_of(str(given))
    if server is not None:
        return simulator_at(*server)
    module, colon, function = str(given).partition(":")
    if given.exists() or not colon:
        return None
    if not all(name.isidentifier() for name in (*module.split("."), function)):
        raise SettingError(f"--simulated {given}: no such file; give FILE.csv, module:function or tcp://HOST:PORT")
    sys.path.insert(0, "")
    try:
        found = getattr(importlib.import_module(module), function)
    except (Exception, SystemExit) as error:  # of the user's module
        reason = f"{type(error).__name__}: {error}"
        raise SettingError(f"--simulated {given}: {reason}; give FILE.csv or module:function") from None
    finally:
        sys.path.remove("")
    if not callable(found):
        raise SettingError(f"--simulated {given}: {function} is a {type(found).__name__}, expected a function")
    return cast(Simulator, found)


def _check_out(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise SettingError(f"--out {out}: is a file, expected a folder; give another name")


@contextmanager
def _progress() -> Iterator[Progress]:
    """Show a progress bar on stderr if it is a terminal."""
    with bars() as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda message, share: bar.update(task, completed=share, description=message)


def summary(diagnosis: Diagnosis, out: Path) -> list[str]:
    """Return the verdict as at most twelve lines of text, warnings first."""
    model = f"   model: {out / 'corrected'}" if diagnosis.corrected is not None else "   no correction is offered"
    return [*diagnosis.summary().splitlines(), f"report: {out / 'report.html'}{model}"]
