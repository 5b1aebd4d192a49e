"""Where things are, and how to run the command."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
SHARED = Path(os.environ.get("DRONEPOSE_SHARED", ROOT.parent / "shared"))

# For ``pytest.mark.filterwarnings``.
FORK_WARNING = "ignore:This process .* is multi-threaded:DeprecationWarning"
CORES_WARNING = "ignore:This DataLoader will create:UserWarning"  # where there is one core


def command(name: str = "dronepose-eval") -> list[str]:
    """``dronepose-eval`` or ``dronepose`` of this Python, as a script if it is installed."""
    script = Path(sys.executable).with_name(name)
    module = {"dronepose-eval": "dronepose.cli", "dronepose": "dronepose"}[name]
    return [str(script)] if script.exists() else [sys.executable, "-m", module]


def run(
    *args: object, cwd: Path | None = None, timeout: float = 300, name: str = "dronepose-eval"
) -> subprocess.CompletedProcess[str]:
    """Run ``dronepose-eval`` or ``dronepose``; the caller looks at the exit code."""
    return subprocess.run(
        [*command(name), *map(str, args)],
        cwd=cwd,
        capture_output=True,
        text=True,
        encoding="utf-8",
        stdin=subprocess.DEVNULL,
        timeout=timeout,
        check=False,
    )


def no_constant(text: str) -> Any:
    raise ValueError(f"{text} in JSON")


def loads(text: str) -> Any:
    """JSON in the strict sense: neither NaN nor Infinity."""
    return json.loads(text, parse_constant=no_constant)


def evaluate(*args: object, cwd: Path | None = None) -> dict[str, Any]:
    """The JSON of ``dronepose-eval ARGS --json -``, which has to succeed."""
    done = run(*args, "--json", "-", cwd=cwd)
    assert done.returncode == 0, f"{done.args}\n{done.stderr}"
    return loads(done.stdout)


def rows(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
