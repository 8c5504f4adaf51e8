"""`glissando doctor`: versions, optional packages, BLAS and serial devices of an installation."""

from __future__ import annotations

import argparse
import json
import os
from typing import Any

from rich.markup import escape

from glissando.cli.console import Console
from glissando.cli.shared import Commands, add_command
from glissando.evaluation.environment import system

_HELP = """\
Tell what this installation has: versions, optional packages and the extra that brings each, the
BLAS library and its threads, and serial devices with their latency timer and whether this user may
open them. Nothing is opened or changed.
"""
_EXAMPLES = """\
examples:
  glissando doctor
  glissando doctor --json > doctor.json      # for a bug report

exit status: 0, whatever is found.
"""
_SLOW_MS = 1


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    parser = add_command(commands, "doctor", (_HELP, _EXAMPLES), _doctor)
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _doctor(options: argparse.Namespace) -> int:
    findings = system()
    if options.json:
        print(json.dumps(findings))
    else:
        Console().print("\n".join(advice(findings)), highlight=False, soft_wrap=True)
    return 0


def advice(findings: dict[str, Any]) -> list[str]:
    """Findings as lines of text, with a remedy for each problem.

    Args:
        findings: Result of `glissando.evaluation.environment.system`.
    """
    lines = [f"{name} {number}" for name, number in findings["versions"].items()]
    lines.append(f"{findings['platform']}, {findings['cores']} cores")
    for pool in findings["blas"]:
        lines.append(f"BLAS: {pool['library']} {pool['version']}, {pool['threads']} threads")
        if pool["threads"] and pool["threads"] > 1 and "OMP_NUM_THREADS" not in os.environ:
            lines[-1] += "; several runs at once go faster with OMP_NUM_THREADS=1"
    for entry in findings["optional"]:
        have = entry["version"] or f"missing: pip install 'glissando[{entry['extra']}]'"
        lines.append(f"{entry['package']} ({entry['extra']}): {have}")
    return [escape(line) for line in [*lines, *_serial(findings["serial"])]]


def _serial(devices: list[dict[str, Any]] | None) -> list[str]:
    if devices is None:
        return ["serial devices: unknown, pyserial is missing: pip install pyserial"]
    if not devices:
        return ["serial devices: none"]
    lines = []
    for port in devices:
        line = f"{port['device']}: {port['description']}"
        if not port["may_open"]:
            group = port["group"] or "dialout"
            line += f"; may not be opened: run sudo usermod -aG {group} $USER and log in again"
        if port["latency_ms"] is not None and port["latency_ms"] > _SLOW_MS:
            name = port["device"].rsplit("/", 1)[-1]
            line += (
                f"; latency timer {port['latency_ms']} ms: echo 1 | sudo tee "
                f"/sys/bus/usb-serial/devices/{name}/latency_timer"
            )
        lines.append(line)
    return lines
