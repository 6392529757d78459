# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""``newton-avbd properties``: what Newton's solvers honour of what a scene can author.

Each property is tried on the smallest scene that shows it and that can be solved by hand. On the
CPU, at 240 steps a second.
"""

import argparse
import json
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

from newton_avbd.io.errors import UserError, unknown
from newton_avbd.io.options import check_writable
from newton_avbd.io.output import STANDARD_OUTPUT, tables_beside, write_json, writing
from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.settings import SCENE_SETTINGS
from newton_avbd.study.bench.run import describe_machine
from newton_avbd.study.properties.body import BODIES
from newton_avbd.study.properties.cable import CABLES
from newton_avbd.study.properties.contact import CONTACTS
from newton_avbd.study.properties.joint import JOINTS
from newton_avbd.study.properties.mujoco import ATTRIBUTES, MUJOCO, pattern_of, registered
from newton_avbd.study.properties.property import Catalog, Outcome, Property, judge
from newton_avbd.study.properties.solvers import SOLVERS

GROUPS: dict[str, Catalog] = {
    "Contacts": CONTACTS,
    "Joints": JOINTS,
    "Bodies": BODIES,
    "Cables": CABLES,
    "MuJoCo": MUJOCO,
}
"""Properties by what they belong to."""

PROPERTIES: dict[str, Property] = {**CONTACTS, **JOINTS, **BODIES, **CABLES, **MUJOCO}
"""All properties by name."""

INTRODUCTION = """\
# What solvers honour

Each property that a Newton scene can author is tried with each solver, on the smallest scene that
shows it. The result is compared with a number that a closed form gives. [Scenes](#scenes) lists the
scenes and the numbers. All ran on a CPU at 240 steps a second.

{measured}

- **yes**: within the bound.
- a **percentage** or a number: the error; **never**: what should happen did not.
- *ignored*: authoring the property makes no difference.
- *error*: the solver refuses, in the words of the note.
- *not finite*: the state was not finite at the end.

A solver that ignores a property mostly does so by documented choice; it is no defect. If a solver
honours a property only with an option, the option was set ([Settings](#settings)). This page and
the numbers behind it, [properties.json](properties.json), are written by

    newton-avbd properties --json docs/properties.json --output docs/properties.md

Choose a group of properties; below are the same results as tables.

```{study-plot} properties
```"""


ATTRIBUTES_INTRODUCTION = """\
All attributes that `SolverMuJoCo.register_custom_attributes` declares, in the namespace `mujoco`.
SolverMuJoCo takes all of them. SolverSteel reads equality constraints and refuses those that it
does not enforce; the other solvers read none. *Tried by* names rows above, or says that tests
compare with a closed form; an attribute without an entry changes no motion, or is not tried. If an
attribute is ignored, the table has the reason. If ignoring it changes the motion by more than the
softness of MuJoCo's constraints, the solver warns.
[From MuJoCo](from_mujoco.md) says more."""


def catalog() -> dict[str, dict[str, str]]:
    """The properties of each group."""
    return {group: dict.fromkeys(properties, "") for group, properties in GROUPS.items()}


def main(args: argparse.Namespace) -> int:
    """Try solvers on properties, print each outcome and write the page; 0, or 130 after Ctrl-C."""
    chosen = _choose(args.names)
    known = _read(args.json)
    check_writable(args.json, args.output)
    machine = describe_machine(None)
    day, processor = machine["date"][:10], machine["processor"]
    solvers = args.solvers or SOLVERS
    with tables_beside(args.json), interruptible() as interruption:
        for property_ in progress(chosen, len(chosen), "properties", lambda tried: tried.name):
            for solver in solvers:
                outcome = replace(judge(property_, solver), date=day, processor=processor)
                known[property_.name, solver] = outcome
                say(f"{property_.name:36} {solver:7} {outcome.verdict}")
            # now and not at the end: some solvers take half an hour for all
            if args.json not in (None, STANDARD_OUTPUT):
                write_json(args.json, _entries(known))
    if args.json == STANDARD_OUTPUT:
        write_json(args.json, _entries(known))
    if args.output:
        with writing(args.output):
            args.output.write_text(page(_in_order(known)))
    return interruption.status(0)


def _entries(known: dict[tuple[str, str], Outcome]) -> list[dict[str, object]]:
    """Outcomes as JSON holds them; older ones have no date and no processor."""
    entries = [asdict(outcome) for outcome in _in_order(known)]
    return [{key: value for key, value in entry.items() if value != ""} for entry in entries]


def _in_order(known: dict[tuple[str, str], Outcome]) -> list[Outcome]:
    """Outcomes in the order of the catalog; those of properties that are no more go."""
    keys = [(name, solver) for name in PROPERTIES for solver in SOLVERS]
    return [known[key] for key in keys if key in known]


def page(outcomes: Iterable[Outcome]) -> str:
    """The documentation's page: tables of outcomes, then scenes and settings."""
    outcomes = list(outcomes)
    table = {(outcome.property, outcome.solver): outcome for outcome in outcomes}
    solvers = [solver for solver in SOLVERS if any(key[1] == solver for key in table)]
    notes: list[str] = []
    parts = [INTRODUCTION.replace("{measured}", _measured(outcomes))]
    for title, catalog in GROUPS.items():
        head = ["property", *(SOLVERS[solver][0] for solver in solvers)]
        lines = [_row(head), _row(["---"] * len(head))]
        for name in catalog:
            cells = [_cell(table.get((name, solver)), notes) for solver in solvers]
            if any(cells):
                lines.append(_row([name, *cells]))
        parts += [f"## {title}", "\n".join(lines)]
    parts.append("\n".join(f"{index}. {note}" for index, note in enumerate(notes, 1)))
    parts.append(attributes())
    parts.append("## Scenes\n\nIn brackets: the value that the closed form gives, and the bound.")
    for title, catalog in GROUPS.items():
        parts.append(f"### {title}\n\n" + "\n".join(_describe(p) for p in catalog.values()))
    parts.append("## Settings\n\n" + "\n".join(_settings()))
    return "\n\n".join(part for part in parts if part) + "\n"


def _measured(outcomes: list[Outcome]) -> str:
    """When, on what, and with which scheme, in sentences."""
    days = sorted({outcome.date for outcome in outcomes if outcome.date})
    processors = sorted({outcome.processor for outcome in outcomes if outcome.processor})
    older = sum(not outcome.date for outcome in outcomes)
    lines = []
    if days:
        when = f"on {days[0]}" if len(days) == 1 else f"from {days[0]} to {days[-1]}"
        scheme = SCENE_SETTINGS["scheme"].default
        lines.append(f"Measured {when} on {' and on '.join(processors)}.")
        lines.append(f"SolverAVBD had its default scheme, `{scheme}`.")
    if older:
        lines.append(
            f"{older} of the {len(outcomes)} outcomes are older, with the defaults of their day.\n"
            "They have no date in properties.json."
        )
    return "\n".join(lines)


def attributes() -> str:
    """The section of what MuJoCo's namespace authors, an attribute a row."""
    lines = [_row(["attribute", "in SolverAVBD", "tried by"]), _row(["---"] * 3)]
    for attribute in registered():
        pattern = pattern_of(attribute)
        lines.append(_row([f"`{attribute}`", *(ATTRIBUTES[pattern] if pattern else ("", ""))]))
    return f"## Attributes of MuJoCo\n\n{ATTRIBUTES_INTRODUCTION}\n\n" + "\n".join(lines)


def _choose(names: list[str]) -> list[Property]:
    """Properties whose names start with one of ``names``; all of them for none.

    Raises:
        UserError: A name starts none.
    """
    for name in names:
        if not any(known.startswith(name) for known in PROPERTIES):
            raise unknown("property", name, PROPERTIES)
    starts = tuple(names) or ("",)
    return [entry for name, entry in PROPERTIES.items() if name.startswith(starts)]


def _read(path: Path | None) -> dict[tuple[str, str], Outcome]:
    """Outcomes of an earlier run; none without a file."""
    if path in (None, STANDARD_OUTPUT) or not path.exists():
        return {}
    try:
        entries = [Outcome(**entry) for entry in json.loads(path.read_text())]
    except (OSError, ValueError, TypeError) as error:
        raise UserError(f"cannot read {path}: {error}") from error
    return {(entry.property, entry.solver): entry for entry in entries}


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(outcome: Outcome | None, notes: list[str]) -> str:
    """A table's entry; errors become numbered notes."""
    if outcome is None:
        return ""
    if outcome.verdict.startswith("error: "):
        note = outcome.verdict.removeprefix("error: ")
        if note not in notes:
            notes.append(note)
        return f"*error* ({notes.index(note) + 1})"
    if outcome.verdict in ("ignored", "not finite"):
        return f"*{outcome.verdict}*"
    return f"**{outcome.verdict}**" if outcome.verdict == "yes" else outcome.verdict


def _describe(property_: Property) -> str:
    """A property's scene, closed form and bound, as an entry of a list."""
    if property_.rules:
        rules = ", ".join(f"{name} {value:g}" for name, value in property_.rules.items())
        return f"- `{property_.name}`: {property_.scene} ({rules})"
    unit = f" {property_.unit}" if property_.unit else ""
    bound = f"{property_.expected:.4g}{unit} within {property_.bound:.2g}"
    return f"- `{property_.name}`: {property_.scene} ({bound})"


def _settings() -> list[str]:
    """Settings of the solvers, and what switches properties on, as entries of a list."""
    lines = []
    for solver, (name, defaults) in SOLVERS.items():
        special: dict[str, list[str]] = {}
        for property_ in PROPERTIES.values():
            if solver in property_.settings:
                special.setdefault(_options(property_.settings[solver]), []).append(property_.name)
        text = f"- {name}: {_options(defaults) or 'defaults'}"
        for options, names in special.items():
            text += f"; {options} for {', '.join(names)}"
        lines.append(text)
    return lines


def _options(settings: dict[str, object]) -> str:
    """Settings as a caller writes them; custom attributes by their names."""
    flat = {key: value for key, value in settings.items() if key != "attributes"}
    custom = settings.get("attributes")
    if isinstance(custom, dict):
        flat |= {f"mujoco:{key}": value for key, value in custom.items()}
    return ", ".join(f"`{key}={value}`" for key, value in flat.items())
