"""`calib simulate`: the vehicle in motion with wrong, right and corrected radii; logged runs replayed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, table, wants_stdout

__all__ = ["register"]

EPILOG = "Example: calib simulate corrected --law sample_runs/corridor --output section7"


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""

    @application.command(name, epilog=EPILOG)
    def simulate(
        study: str | None = typer.Argument(None, help="symmetric, asymmetric, corrected, or custom."),
        route: list[str] = typer.Option(
            [],
            "--route",
            help="corridor, straight15, paper_route, square_cw, square_ccw, figure8, or a .toml or .tum file; again "
            "for more.",
        ),
        which: str = typer.Option("right", "--wheel", help="Which wheel --ratio sets off: right, left, both, equal."),
        ratio: str | None = typer.Option(None, "--ratio", metavar="E,E..", help="Ratios of radii, E_r = r_R / r_L."),
        believed: str | None = typer.Option(None, "--believed", metavar="L,R", help="Radii the odometry believes, m."),
        real: str | None = typer.Option(None, "--real", metavar="L,R", help="Real radii, m."),
        track: float | None = typer.Option(None, "--track", metavar="M", help="Track (0.7, or that of the law)."),
        real_track: float | None = typer.Option(None, "--real-track", metavar="M", help="Real track, if another."),
        law: Path | None = typer.Option(
            None,
            "--law",
            "--model",
            metavar="PATH",
            help="Fitted law: campaign, result folder of calib fit, or coefficient file, also one of calib "
            "diagnose --apply.",
        ),
        load: list[str] = typer.Option(
            [], "--load", metavar="L,R", help="Wheel loads of a journey under the law, N; again for more."
        ),
        payload: list[str] = typer.Option(
            [], "--payload", metavar="KG,X,Y", help="The same from a payload and its place; again for more."
        ),
        payload_at: list[str] = typer.Option(
            [],
            "--payload-at",
            metavar="S,KG,X,Y",
            help="Payload from S m along the route on, 0 kg to unload; again for more. Unladen before the first one.",
        ),
        reference: str = typer.Option(
            "300,300", "--reference-load", metavar="L,R", help="Loads whose radii the uncorrected odometry uses, N."
        ),
        draws: int = typer.Option(20_000, "--draws", help="Draws of the Monte Carlo."),
        seed: int = typer.Option(0, "--seed", help="Seed of everything that is drawn."),
        replay: Path | None = typer.Option(
            None, "--replay", metavar="CAMPAIGN", help="Replay the logged runs of a campaign instead."
        ),
        scheme: str = typer.Option("exact", "--scheme", help="Replay with exact, mid_point, euler or end_point."),
        output: Path | None = typer.Option(None, "--output", metavar="FOLDER", help="Write figures and tables there."),
        tum: Path | None = typer.Option(None, "--tum", metavar="FOLDER", help="Write trajectories there, TUM format."),
        speed: float = typer.Option(0.5, "--speed", metavar="M/S", help="Speed that times the trajectories."),
        json: str | None = JSON,
        force: bool = FORCE,
    ) -> None:
        """Simulate a vehicle that follows a route on its own odometry, with and without the load correction.

        Studies by name are those of the paper's Section 7; with --law the same journeys are driven under a fitted law,
        its 95 % band carried to the end pose by linear propagation and by Monte Carlo.
        """
        import numpy as np

        from calib.errors import BadInputError

        rng = np.random.default_rng(seed)
        if replay is not None:
            if payload_at:
                raise BadInputError(
                    "--payload-at: found beside --replay; expected the loads in the logs; give them the columns "
                    "load_left_N and load_right_N"
                )
            if study is not None:
                raise BadInputError(f"--replay: found the study {study!r} beside it; expected one of the two")
            _replay(replay, law, scheme, output, tum, rng, json, force)
            return
        if study is None:
            raise BadInputError(
                "found no study; expected symmetric, asymmetric, corrected, custom, or --replay CAMPAIGN"
            )
        if not speed > 0.0:
            raise BadInputError(f"--speed: found {speed!r}; expected a speed above 0 m/s")
        from calib.motion.studies.request import request
        from calib.motion.studies.run import simulate as run

        asked = request(
            law=law,
            track_m=track,
            which=which,
            ratios=ratio,
            believed=believed,
            real=real,
            loads=load,
            payloads=payload,
            payloads_at=payload_at,
            reference=reference,
        )
        found = run(
            study,
            routes=route,
            cases=asked.cases,
            track_m=asked.track_m,
            real_track_m=real_track,
            law=asked.law,
            loads_N=asked.loads_N,
            reference_N=asked.reference_N,
            loading=asked.loading,
            track_std_m=asked.track_std_m,
            walk=asked.walk,
            draws=draws,
            rng=rng,
        )
        written = []
        if output is not None or tum is not None:
            from calib.report.motion_files import publish_simulation, simulation_trajectories

            if output is not None:
                written += publish_simulation(found, output, force=force)
            if tum is not None:
                written += simulation_trajectories(found, tum, speed_mps=speed, force=force)
        notes = [*asked.notes, *(found.law.notes if found.law else ())]
        document = found.document() | {"seed": seed, "notes": notes, "files": [str(path) for path in written]}
        emit_json(document, json, force=force)
        if not wants_stdout(json):
            _show(found)
            for note in notes:
                say(f"note: {note}")
            for path in written:
                say(f"wrote {path}")


def _show(found: Any) -> None:
    import math

    for name, sweep in found.sweeps.items():
        table(
            f"{name}: {sweep.route.name}, track {sweep.track_m:g} m; end of the route, true minus intended",
            (
                "vehicle",
                "end x (m)",
                "end y (m)",
                "theta (deg)",
                "e_x along",
                "e_y left",
                "global x",
                "global y",
                "dist.",
            ),
            (
                (
                    str(row["case"]),
                    f"{row['end_x_m']:.6f}",
                    f"{row['end_y_m']:.6f}",
                    f"{math.degrees(row['end_theta_rad']):.4f}",
                    *(
                        f"{round(row[f'error_{key}_m'], 5) + 0.0:+.5f}"
                        for key in ("along", "lateral", "global_x", "global_y")
                    ),
                    f"{row['error_distance_m']:.6f}",
                )
                for row in sweep.ends()
            ),
        )
    if found.headlines:
        from calib.motion.studies.paper_headline import paper_headline

        paper = paper_headline()
        table(
            "Largest global e_x at the end without and with the correction "
            f"(paper: {paper['before_m']:g} m, {paper['after_m']:g} m, about {paper['ratio']:.0f})",
            ("wheel off", "without (m)", "with (m)", "times smaller"),
            (
                (line.which, f"{line.without_m:.5f}", f"{line.corrected_m:.5f}", f"{line.ratio:.1f}")
                for line in found.headlines
            ),
        )
    if found.law is not None:
        _show_law(found.law)
        if len(found.law.path.loading.from_m) > 1:
            _show_path(found.law.path, list(found.sweeps.values())[-1].route.name)


def _show_law(part: Any) -> None:
    table(
        "Table 1: effective radii by the law, mm, with the 95 % half-widths of mean and single run",
        ("load (N)", "left", "mean", "run", "right", "mean", "run"),
        (
            (
                f"{row.load_N:g}" + ("*" if row.extrapolated_left or row.extrapolated_right else ""),
                *(
                    f"{1e3 * value:.4f}"
                    for value in (
                        row.radius_left_m,
                        row.mean_left_m,
                        row.prediction_left_m,
                        row.radius_right_m,
                        row.mean_right_m,
                        row.prediction_right_m,
                    )
                ),
            )
            for row in part.table
        ),
    )
    if any(row.extrapolated_left or row.extrapolated_right for row in part.table):
        say("* outside the loads that were measured")
    rows = []
    for j in part.journeys:
        e = j.corrected["lateral_m"]
        low, high = j.ratio_ci95
        rows.append(
            (
                f"{j.load_left_N:.0f} / {j.load_right_N:.0f}, {'mean' if j.band == 'mean' else 'run'}",
                f"{j.radius_ratio:.5f}",
                f"{j.without_rms_m:.4f}",
                f"{j.corrected_rms_m:.4f}",
                f"{j.corrected_95_m:.4f}",
                f"{0.5 * (e.linear[1] - e.linear[0]):.4f}",
                f"{0.5 * (e.monte_carlo[1] - e.monte_carlo[0]):.4f}",
                f"{j.ratio:.1f} [{low:.1f}, {high:.1f}]",
            )
        )
    table(
        "End error under the law, m: without and with the correction",
        (
            "loads L / R, band",
            "E_r",
            "without, rms",
            "with, rms",
            "with, 95 %",
            "e_y ± linear",
            "e_y ± MC",
            "ratio [95 %]",
        ),
        rows,
    )


def _show_path(path: Any, route: str) -> None:
    factors = {"along_m": 1.0, "lateral_m": 1.0, "heading_rad": 1e3, "global_x_m": 1.0, "global_y_m": 1.0}
    ends = {"of the reference load": path.without.end(), "that follow the load": path.corrected.end()}
    rows = []
    for title, end in ends.items():
        errors = (f"{round(factor * end[f'error_{key}'], 4) + 0.0:+.4f}" for key, factor in factors.items())
        rows.append((title, *errors, f"{end['rms_m']:.4f}"))
        spread = (f"± {factor * end[f'std_{key}']:.4f}" for key, factor in factors.items())
        rows.append(("", *spread, ""))
    table(
        f"{route}, {path.loading_text}: end error in m and mrad, with its standard uncertainty",
        ("radii", "e_x along", "e_y left", "e_theta", "global x", "global y", "rms"),
        rows,
    )
    low, high = path.ratio_ci95
    say(
        f"Radii that follow the load make the end error {path.ratio:.1f} times smaller "
        f"(95 % interval {low:.1f} to {high:.1f})."
    )


def _replay(
    folder: Path,
    law: Path | None,
    scheme: str,
    output: Path | None,
    tum: Path | None,
    rng: Any,
    json: str | None,
    force: bool,
) -> None:
    from calib.campaign.read import read_campaign
    from calib.coefficients.source import coefficients_of, effects_left_out
    from calib.motion.studies.replay import replay
    from calib.report.motion_files import publish_replay, replay_trajectories

    campaign = read_campaign(folder)
    source = coefficients_of(law if law is not None else folder)
    found = replay(campaign, source.file, rng=rng, scheme=scheme)
    notes = [*source.notes, *effects_left_out(source.file, "not simulated")]
    if law is None:
        notes.append(
            "the law was fitted to this same campaign: give --law for a judgement on runs that it has not seen"
        )
    document = {
        "campaign": campaign.name,
        "simulated": campaign.simulated,
        "scheme": scheme,
        **found.document(),
        "notes": notes,
    }
    written = [] if output is None else publish_replay(found, output, document, force=force)
    if tum is not None:
        written += replay_trajectories(campaign, source.file.law, source.file.geometry.track_m, tum, force=force)
    emit_json(document | {"files": [str(path) for path in written]}, json, force=force)
    if wants_stdout(json):
        return
    names = {
        "model": "as the simulator believes",
        "constant": "law's radii, unladen, kept",
        "corrected": "law's radii at the load carried",
    }
    table(
        f"{campaign.name}{' (simulated)' if campaign.simulated else ''}: end error of {int(found.in_range.sum())} runs",
        ("radii", "rms (m)", "rms heading (mrad)"),
        ((title, f"{found.rms_m[key]:.4f}", f"{1e3 * found.rms_heading_rad[key]:.2f}") for key, title in names.items()),
    )
    low, high = found.ratio_ci95
    say(f"The correction makes the end error {found.ratio:.1f} times smaller (95 % interval {low:.1f} to {high:.1f}).")
    check = found.runtime
    say(
        f"The vehicle's runtime on {check.runs} of these runs, {check.samples} samples: differs from the arrays by at "
        f"most {check.largest_difference_m:.2g} m and {check.largest_difference_rad:.2g} rad."
    )
    for status, count in check.faults.items():
        say(f"The runtime refused {count} times: {status}.")
    for reason, count in found.left_out.items():
        if count:
            say(f"{count} runs left out: {reason}.")
    for note in notes:
        say(f"note: {note}")
    for path in written:
        say(f"wrote {path}")
