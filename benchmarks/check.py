# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Say which scenes are slower than the stored baseline by more than a tenth.

    python -m benchmarks.check                # all scenes
    python -m benchmarks.check pyramid stack  # some
    python -m benchmarks.check --write        # store what is measured as the baseline

Compared are ratios to ``mj_step`` in the same run with ratios of the baseline. A scene that is
slower is measured again, since noise passes and a regression stays. Exit status 1 where one is
slower each time, 130 after Ctrl-C, which leaves what was measured until then.
"""

import argparse
import json
import statistics
import sys
from pathlib import Path

from newton_avbd.io.terminal import interruptible, progress, say
from newton_avbd.study.bench.run import describe_machine, pinned

from .ratios import SCENES, ratio

BASELINE = Path(__file__).parent / "baseline.json"
ALLOWED = 1.1
"""Largest ratio to the baseline."""

ATTEMPTS = 3


def slower(measured: float, known: float) -> bool:
    """Whether a ratio is above the baseline's by more than is allowed."""
    return measured > ALLOWED * known


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.check", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="default: all")
    parser.add_argument("--write", action="store_true", help="store the baseline instead")
    args = parser.parse_args(argv)
    if unknown := [name for name in args.scenes if name not in SCENES]:
        parser.error(f"there is no scene {unknown[0]!r}; there are: {', '.join(SCENES)}")
    stored = json.loads(BASELINE.read_text()) if BASELINE.exists() else {"ratios": {}}
    known: dict[str, float] = stored["ratios"]
    theirs, here = stored.get("machine", {}).get("processor"), describe_machine(None)["processor"]
    if theirs and theirs != here and not args.write:
        print(
            f"The baseline is of another processor ({theirs}; here {here}), on which ratios of the "
            "same version have differed by up to 18%. Compare with the version before, here."
        )
    failed = []
    scenes = args.scenes or SCENES
    with interruptible() as interruption:
        for scene in progress(scenes, len(scenes), "scenes", str):
            measured = ratio(scene)
            if args.write:
                # noise would make a single ratio a baseline that is too high, or one never reached
                more = [ratio(scene) for _ in range(ATTEMPTS - 1)]
                measured = statistics.median([measured, *more])
                known[scene] = round(measured, 4)
                say(f"{scene:<16} {measured:.3f} mj_steps")
                continue
            if scene not in known:
                say(f"{scene:<16} {measured:.3f} mj_steps, not in the baseline")
                continue
            for _ in range(ATTEMPTS - 1):
                if slower(measured, known[scene]):
                    measured = min(measured, ratio(scene))
            change = measured / known[scene] - 1.0
            verdict = "SLOWER" if slower(measured, known[scene]) else "ok"
            failed += [scene] if verdict == "SLOWER" else []
            say(
                f"{scene:<16} {measured:.3f} mj_steps, baseline {known[scene]:.3f}, "
                f"{change:+.0%}  {verdict}"
            )
    if args.write:
        ordered = {scene: known[scene] for scene in SCENES if scene in known}
        with pinned() as core:  # as ratio does
            machine = describe_machine(core)
        content = {"machine": machine, "unit": "mj_steps", "ratios": ordered}
        BASELINE.write_text(json.dumps(content, indent=1) + "\n")
    elif failed:
        print(f"slower by more than {ALLOWED - 1:.0%} than the baseline: {', '.join(failed)}")
        print("Where the version before is as slow here, it is the machine.")
    return interruption.status(int(bool(failed)))


if __name__ == "__main__":
    sys.exit(main())
