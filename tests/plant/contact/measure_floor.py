# ruff: noqa: T201  (a script shows its result)
"""Print the floor of the contact plant's own numerical noise: ``python -m tests.plant.contact.measure_floor``."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from tests.plant.contact.floor import noise_floor
from tests.plant.contact.machine import Machine


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=6)
    parser.add_argument("--length", type=float, default=20.0, help="corridor, m")
    parser.add_argument("--curve-speed", type=float, default=0.2, help="m/s")
    parser.add_argument("--shape", choices=("crowned", "flat"), default="crowned")
    parser.add_argument("--dimensions", type=int, choices=(3, 4, 6), default=3)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    sound = Machine()
    machine = replace(sound, tyre=replace(sound.tyre, shape=args.shape, dimensions=args.dimensions))
    floor = noise_floor(
        machine,
        np.random.default_rng(args.seed),
        repeats=args.repeats,
        length_m=args.length,
        curve_speed_mps=args.curve_speed,
    )
    model = floor.baseline.model
    print(
        f"baseline: radius {model.radius_left_m * 1e3:.6f} / {model.radius_right_m * 1e3:.6f} mm at "
        f"{model.reference_load_N:.2f} N, slope {model.slope_left_m_per_N * 1e9:.3f} nm/N, "
        f"track {model.track_m * 1e3:.4f} mm, largest misfit {floor.baseline.misfit_m * 1e9:.1f} nm"
    )
    print(f"effective radius: halved step {floor.radius_step:.1e}, repeats {floor.radius_repeats:.1e} (relative)")
    print(f"straight drift, unladen: {floor.straight_drift_m * 1e6:.2f} um over {args.length:g} m")
    print("gap at the end, along um / lateral um / heading urad")
    print(
        f"{'route':<11} {'kg':>4} {'repeats, exact':>24} {'repeats, counted':>24} {'halved step':>24} "
        f"{'remainder of the model':>24}"
    )
    for run in floor.runs:
        cells = [
            " / ".join(f"{1e6 * value:.2f}" if abs(value) < 1e-4 else f"{1e6 * value:.0f}" for value in triple)
            for triple in (run.repeats_exact, run.repeats_counted, run.halved_step, run.remainder)
        ]
        print(f"{run.kind:<11} {run.payload_kg:4.0f} " + " ".join(f"{cell:>24}" for cell in cells))


if __name__ == "__main__":
    main()
