"""Entry point of the console command `sonar-gym`: in no package, so that it can tell which package is shadowed."""

from __future__ import annotations

import signal


def main() -> None:
    """Run the command line. Ctrl-C while its packages are imported ends it without a traceback."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # not where a shell has begun a background job that ignores it
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        import acquisition
    except ImportError as error:
        raise SystemExit(f"sonar-gym: {error}") from None
    if not hasattr(acquisition, "SonarError"):  # said here, since nothing of the package that is hidden can say it
        raise SystemExit(
            f"sonar-gym: `import acquisition` finds {acquisition.__file__}, not sonar-gym: "
            "rename it, since Python finds it first"
        )
    from acquisition.name_check import ForeignNameError, check_names, foreign

    try:
        check_names("training")
        from training.cli import main as run
    except ForeignNameError as error:
        raise SystemExit(f"sonar-gym: {error}") from None
    except (ImportError, AttributeError):
        if (reason := foreign()) is None:
            raise
        raise SystemExit(f"sonar-gym: {reason}") from None

    signal.signal(signal.SIGINT, before)
    run()
