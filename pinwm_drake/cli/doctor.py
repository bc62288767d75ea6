# SPDX-License-Identifier: MIT
"""`pinwm doctor`: a line for each finding, and what to do about those that are not well."""

import json
from dataclasses import asdict

from rich.console import Console
from rich.markup import escape

from pinwm_drake.cli.console import say
from pinwm_drake.experiments.requests.doctor import DoctorRequest

_STYLES = {"ok": "green", "slow": "yellow", "broken": "bold red"}


def doctor(request: DoctorRequest) -> None:
    """Check the installation: versions, cores, caches, rendering.

    It says what is slow here and what to do. Exits with 1 where something that is needed does not work.
    """
    from pinwm_drake.experiments.doctor import examine

    console, findings = Console(), []
    for finding in examine(request.out):
        findings.append(finding)
        if not request.json:
            mark = f"[{_STYLES[finding.status]}]{finding.status:<6}[/]"
            console.print(f"{mark}  {finding.name:<11}{escape(finding.found)}", highlight=False, soft_wrap=True)
    broken = any(one.status == "broken" for one in findings)
    if request.json:
        say(json.dumps({"broken": broken, "findings": [asdict(one) for one in findings]}, indent=1))
    else:
        for one in findings:
            if one.advice:
                console.print(
                    f"[{_STYLES[one.status]}]{one.name}[/]: {escape(one.advice)}", highlight=False, soft_wrap=True
                )
        say("something that is needed does not work" if broken else "everything that is needed works")
    if broken:
        raise SystemExit(1)
