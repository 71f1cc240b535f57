"""Recordings changed as users' recordings are: ``python -m benchmarks.mutations --seeds 20``.

Takes of `benchmarks.hand_moved` with labels, white noise, default options; the changes stand in `benchmarks.changes`.
"""

import argparse
import time
from collections import Counter

import numpy as np

from benchmarks import scenes
from benchmarks.changes import MUTATIONS, Mutation, Scene
from benchmarks.hand_moved import RATE_HZ
from benchmarks.realism import SIGMA_R, SIGMA_T, WRONG, Effect, Outcome, judged, simulated

STREAM = 0x3A7A
SPARSER = 4
"""Of the frames that `benchmarks.realism` fits, one in so many is taken."""
RATE = RATE_HZ / 2 / SPARSER


def run(job: tuple[str, int]) -> Outcome:
    """One mutation, one seed."""
    name, seed = job
    number = next(k for k, mutation in enumerate(MUTATIONS) if mutation.name == name)
    machine, take = simulated(Effect("white", label_deg=0.0), np.random.default_rng([seed, STREAM]))
    scene = Scene(machine, take.select(slice(None, None, SPARSER)), RATE)
    changed = MUTATIONS[number].change(scene, np.random.default_rng([seed, STREAM, number]))
    take, offsets = changed if isinstance(changed, tuple) else (changed, machine.offset[None])
    return judged(take, offsets)


HEADER = (
    "change",
    "ok, silent",
    "ok, warned",
    "doubtful",
    "refused",
    "error mm",
    "error / sigma",
    "wrong ok",
    "said (runs)",
)


def row_of(mutation: Mutation, found: list[Outcome]) -> list[str]:
    """A row of the table."""
    good = [o for o in found if o.accepted]
    counts = Counter(code for o in found for code in set(o.codes))
    said = ", ".join(f"{code} {count}" for code, count in counts.most_common(3))
    sound = [o for o in good if o.status == "ok"]
    silent = sum(not o.codes for o in sound)
    return [
        mutation.name + (" (*)" if mutation.hidden else ""),
        f"{silent}",
        f"{len(sound) - silent}",
        f"{len(good) - len(sound)}",
        f"{len(found) - len(good)}",
        f"{1e3 * np.median([o.error_m for o in good]):.3f}" if good else "-",
        f"{np.median([np.abs(o.ratio).max() for o in good]):.1f}" if good else "-",
        f"{sum(o.wrong for o in good)}",
        said,
    ]


NOTES = f"""Sweeps moved by hand as in the section on realism, {RATE:g} frames a second, {SIGMA_T * 1e3:.1f} mm and
{np.degrees(SIGMA_R):.2f} deg of white noise, exact labels of the held joints. Numbers of runs; silent: no warning but
on the zeros of the angles; doubtful: the parts of the recording disagree (exit status 3). Error and its ratio to the
stated standard deviation, the worst component: medians over the runs with numbers, against the nearest of the right
offsets where a sensor was re-seated. Wrong ok: numbers with a component off by more than {WRONG:.0f} standard
deviations, whatever was warned of."""


def summary(found: dict[str, list[Outcome]]) -> str:
    """The share of wrong ``ok``, and what cannot be seen."""
    seen = [o for mutation in MUTATIONS if not mutation.hidden for o in found[mutation.name]]
    wrong, silent = sum(o.wrong for o in seen), sum(o.wrong and not o.codes for o in seen)
    hidden = "".join(f"\n- {m.name}: {m.hidden}." for m in MUTATIONS if m.hidden)
    return (
        f"**Wrong ok**: {wrong} of {len(seen)} runs ({wrong / len(seen):.1%}), {silent} of them without a warning, of "
        f"all changes that something in the poses can show. Nothing can show those marked (*):\n{hidden}"
    )


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    begin = time.perf_counter()
    jobs = [(mutation.name, seed) for mutation in MUTATIONS for seed in range(given.seeds)]
    results = iter(scenes.run_all(run, jobs, given.jobs))
    found = {mutation.name: [next(results) for _ in range(given.seeds)] for mutation in MUTATIONS}
    table = scenes.show("Changed recordings", HEADER, [row_of(m, found[m.name]) for m in MUTATIONS])
    total = summary(found)
    print(total)
    head = scenes.provenance(f"python -m benchmarks.mutations --seeds {given.seeds}", time.perf_counter() - begin)
    scenes.write_section("mutations", "\n\n".join(["## Mutations", head, NOTES, table, total]))


if __name__ == "__main__":
    main()
