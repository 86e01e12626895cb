# ruff: noqa: T201  (a script shows its result)
"""Write a campaign of every variant of the contact plant, the truth apart.

``python -m tests.plant.contact.make_cases FOLDER`` writes ``FOLDER/<variant>/`` and ``FOLDER/truth.json``.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from calib.campaign import write_campaign
from calib.io import write_json
from tests.plant.contact.baseline import baseline
from tests.plant.contact.campaign import Lengths, make_contact_campaign
from tests.plant.contact.variants import VARIANTS, sound_machine


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=48)
    parser.add_argument("--strength", type=float, default=1.0)
    parser.add_argument("--length", type=float, default=20.0, help="corridor, m")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--variants", nargs="*", default=list(VARIANTS))
    parser.add_argument("--force", action="store_true")
    args = parser.parse_args()
    began = time.perf_counter()
    sound = baseline(sound_machine())
    write_json(
        args.folder / "truth.json",
        {name: VARIANTS[name].truth(args.strength) for name in args.variants},
        force=args.force,
    )
    for name in args.variants:
        start = time.perf_counter()
        rng = np.random.default_rng([args.seed, list(VARIANTS).index(name)])
        campaign = make_contact_campaign(
            name,
            rng,
            runs=args.runs,
            strength=args.strength,
            lengths=Lengths(corridor_m=args.length),
            sound=sound,
            workers=args.workers,
        )
        write_campaign(campaign, args.folder / name, force=args.force)
        print(f"{name:<20} {args.runs} runs in {time.perf_counter() - start:5.1f} s", flush=True)
    print(f"{len(args.variants)} campaigns in {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
