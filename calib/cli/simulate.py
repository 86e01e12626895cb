"""``calib simulate``: routes, journeys under a law, studies, replays; ``calib challenge``: a blind check."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from calib import cli
from calib.cli import Count, Number, Place, Text, Texts, arg, opt
from calib.documents import plain
from calib.errors import BadInputError

if TYPE_CHECKING:
    from calib.odometry.simulation import Simulation
    from calib.reporting import Block, Section

SPEED_MPS: Final = 0.5
DRAWS: Final = 20_000

_ROUTES = "corridor, straight15, paper_route (the default), square_cw, square_ccw, figure8, or a .toml or .tum file."
_LAW = "Campaign, result folder of calib fit, or coefficient file, also one of calib diagnose --apply."
_PAYLOAD_AT = "Payload from S m along the route on, 0 kg to unload; again for more. Unladen before the first one."
_REFERENCE = "Loads whose radii the uncorrected odometry uses, N (the law's reference)."
Routes = Annotated[Texts, arg("ROUTE", _ROUTES)]
Law = Annotated[Place, opt("PATH", _LAW, "--law", "--model")]
Track = Annotated[Number, opt("M", "Track that the odometry believes (0.7, or the law's).", "--track")]
Draws = Annotated[int, opt(None, "Draws of the Monte Carlo.", "--draws")]
Output = Annotated[Place, opt("FOLDER", "Write figures and tables there.", "--output")]
Tum = Annotated[Place, opt("FOLDER", "Write trajectories there, TUM format.", "--tum")]


def _above_zero(speed_mps: float) -> float:
    if not speed_mps > 0.0:
        raise BadInputError(f"--speed: found {speed_mps!r}; expected a speed above 0 m/s")
    return speed_mps


Speed = Annotated[float, opt("M/S", "Speed that times the trajectories.", "--speed", callback=_above_zero)]


#: folders of figures and of trajectories, and the speed that times these
Targets = tuple[Path | None, Path | None, float]


def _finish(
    simulation: "Simulation", targets: Targets, *, seed: int, notes: Sequence[str] = (), law: Path | None = None
) -> None:
    from calib.reporting.topics.simulation import simulation_content, simulation_trajectories, write_simulation

    (output, tum, speed_mps), force = targets, cli.forced()
    written = [] if output is None else write_simulation(simulation, output, force=force)
    if tum is not None:
        written += simulation_trajectories(simulation, tum, speed_mps=speed_mps, force=force)
    every_note = [*notes, *(simulation.law.notes if simulation.law else ())]
    _tell(simulation.to_dict() | {"seed": seed}, simulation_content(simulation), every_note, written)
    cli.then("simulate --law" if law else "simulate", c=law or "")


def _tell(
    document: dict[str, object], content: "Iterable[Block | Section]", notes: list[str], written: list[Path]
) -> None:
    from calib.reporting import items
    from calib.reporting.formatting import prose

    document |= {"notes": notes, "files": [str(path) for path in written]}
    cli.answer(document, [*content, *items(map(prose, notes))])
    if not cli.wants_stdout():
        cli.wrote(written)


def _loads_N(texts: list[str] | None, option: str) -> list[tuple[float, float]]:
    pairs = [(left, right) for left, right in (cli.numbers(text, 2, option) for text in texts or ())]
    if any(value <= 0.0 for pair in pairs for value in pair):
        raise BadInputError(f"{option}: found 0 N or below; expected loads above 0 N; correct it")
    return pairs


def route(
    route: Routes = None,
    real: Annotated[Text, opt("L,R", "Real radii, m.")] = None,
    believed: Annotated[Text, opt("L,R", "Radii the odometry believes, m (0.1,0.1).")] = None,
    ratio: Annotated[Text, opt("E,E..", "Ratios of radii, E_r = r_R / r_L.")] = None,
    which: Annotated[
        str, opt(None, "Wheel that --ratio sets off: right (the usual), left, both, equal.", "--wheel")
    ] = "",
    track: Track = None,
    real_track: Annotated[Number, opt("M", "Real track, if another.")] = None,
    output: Output = None,
    tum: Tum = None,
    speed: Speed = SPEED_MPS,
) -> None:
    """Drive a route on an odometry that believes other radii than the real ones.

    The vehicle follows the route by its own odometry; what is shown is where it really ends.

    Example: calib simulate route square_cw square_ccw --real 0.099,0.1 --output squares
    """
    import numpy as np

    from calib.odometry.simulation import CUSTOM, Case, simulate
    from calib.vehicle import Vehicle

    vehicle = Vehicle()
    if not ratio:
        cli.refuse_options("without --ratio", {"--wheel": which})
    cases = [Case.off(which or "right", value) for value in (cli.numbers(ratio, None, "--ratio") if ratio else ())]
    if real is not None:
        left, right = cli.numbers(real, 2, "--real")
        base = cli.numbers(believed, 2, "--believed") if believed else (vehicle.wheel_radius_m,) * 2
        if min(left, right, *base) <= 0.0:
            raise BadInputError("--believed, --real: found a radius of 0 or below; expected metres above 0")
        cases.append(Case.given(left / base[0], right / base[1]))
    else:
        cli.refuse_options("without --real", {"--believed": believed})
    if not cases:
        raise BadInputError(
            "found no radii; expected --real or --ratio; under a fitted law it is 'calib simulate journey --law PATH'"
        )
    track_m, rng = vehicle.track_m if track is None else track, np.random.default_rng(0)
    simulation = simulate(CUSTOM, routes=route or (), cases=cases, track_m=track_m, real_track_m=real_track, rng=rng)
    _finish(simulation, (output, tum, speed), seed=0)


def journey(
    law: Annotated[Path, opt("PATH", _LAW, "--law", "--model")],
    route: Routes = None,
    load: Annotated[Texts, opt("L,R", "Wheel loads, N; again for more journeys.")] = None,
    payload: Annotated[Texts, opt("KG,X,Y", "The same from a payload and its place; again for more.")] = None,
    payload_at: Annotated[Texts, opt("S,KG,X,Y", _PAYLOAD_AT)] = None,
    reference: Annotated[Text, opt("L,R", _REFERENCE, "--reference-load")] = None,
    track: Track = None,
    draws: Draws = DRAWS,
    seed: cli.Seed = 0,
    output: Output = None,
    tum: Tum = None,
    speed: Speed = SPEED_MPS,
) -> None:
    """Drive a route under a fitted law, without and with radii that follow the load.

    The 95 % band of the law is carried to the end pose by linear propagation and by Monte Carlo.

    Example: calib simulate journey figure8 --law sample_runs/corridor --payload-at 5,100,0.5,0.1
    """
    import numpy as np

    from calib.odometry.law_path import law_source
    from calib.odometry.routes import carried_loads_N, loading_on_the_way
    from calib.odometry.simulation import CUSTOM, LawJourneys, simulate

    base = _loads_N([reference] if reference else None, "--reference-load")
    loads_N = _loads_N(load, "--load")
    carried = [cli.numbers(text, 3, "--payload") for text in payload or ()]
    changes = [cli.numbers(text, 4, "--payload-at") for text in payload_at or ()]
    source = law_source(law, track)
    loads_N += [carried_loads_N(source.vehicle, mass, x, y) for mass, x, y in carried]
    with cli.progress("driving"):
        loading = loading_on_the_way(source.vehicle, changes) if changes else None
        under = LawJourneys(source, loads_N, base[0] if base else None, loading, draws)
        rng = np.random.default_rng(seed)
        simulation = simulate(CUSTOM, routes=route or (), track_m=under.axle.track_m, under=under, rng=rng)
    _finish(simulation, (output, tum, speed), seed=seed, notes=source.notes, law=law)


def study(
    name: Annotated[str, arg("STUDY", "symmetric, asymmetric or corrected.")],
    law: Law = None,
    load: Annotated[Texts, opt("L,R", "With --law: wheel loads in place of the study's, N.")] = None,
    route: Annotated[Texts, opt(None, "Another route than the study's; again for more.")] = None,
    track: Track = None,
    draws: Annotated[Count, opt(None, "With --law: draws of the Monte Carlo.", "--draws")] = None,
    seed: cli.Seed = 0,
    output: Output = None,
    tum: Tum = None,
    speed: Speed = SPEED_MPS,
) -> None:
    """Run a study of the paper's Section 7: what wrong radii do to a vehicle that follows its own odometry.

    symmetric: both wheels alike. asymmetric: the radii differ. corrected: the radii follow the load, and what is left
    is the 95 % band of the regression. With --law, Table 1 and journeys under that law are added.

    Example: calib simulate study corrected --law sample_runs/corridor --output section7
    """
    import numpy as np

    from calib.odometry.law_path import law_source
    from calib.odometry.simulation import STUDIES, LawJourneys, simulate
    from calib.vehicle import Vehicle

    if name not in STUDIES:
        near = cli.nearest(name, STUDIES)
        raise BadInputError(f"study: found {name!r}; expected one of {', '.join(STUDIES)}{near}")
    loads_N = _loads_N(load, "--load")
    if law is None:
        cli.refuse_options("without --law", {"--load": load, "--draws": draws})
    source = None if law is None else law_source(law, track)
    if source is not None:
        track = source.track_m
    track_m, rng = Vehicle().track_m if track is None else track, np.random.default_rng(seed)
    with cli.progress("simulating"):
        under = None if source is None else LawJourneys(source, loads_N, draws=DRAWS if draws is None else draws)
        simulation = simulate(name, routes=route or (), track_m=track_m, under=under, rng=rng)
    _finish(simulation, (output, tum, speed), seed=seed, notes=() if source is None else source.notes, law=law)


def replay(
    campaign: Annotated[Path, arg("CAMPAIGN", "Campaign with logs and end poses.")],
    law: Law = None,
    scheme: Annotated[str, opt(None, "exact, mid_point, euler or end_point.")] = "exact",
    seed: cli.Seed = 0,
    output: Output = None,
    tum: Tum = None,
) -> None:
    """Replay the logged runs of a campaign: end errors with constant radii and with radii that follow the load.

    The vehicle's own code runs on the same logs, and has to agree.

    Example: calib simulate replay sample_runs/corridor_crossed --law coefficients.json --output replay
    """
    import numpy as np

    from calib.campaign.read import read_campaign
    from calib.coefficients.build import coefficients_of
    from calib.coefficients.file import effects_left_out
    from calib.odometry.replay import replay as replay_runs
    from calib.reporting.topics.simulation import replay_content, replay_trajectories, write_replay

    cli.refuse_outputs(*(output / "replay.json", output / "replay.csv") if output else ())
    with cli.progress("replaying"):
        read = read_campaign(campaign)
        source = coefficients_of(law if law is not None else campaign)
        replayed = replay_runs(read, source.file, rng=np.random.default_rng(seed), scheme=scheme)
    notes = [*source.notes, *effects_left_out(source.file, "not simulated"), *replayed.notes]
    if law is None:
        notes.append(
            "the law was fitted to this same campaign: give --law for a judgement on runs that it has not seen"
        )
    document = replayed.to_dict() | {"scheme": scheme, "notes": notes}
    written = [] if output is None else write_replay(replayed, output, document, force=cli.forced())
    if tum is not None:
        written += replay_trajectories(read, source.file, tum, force=cli.forced())
    _tell(document, replay_content(replayed), notes, written)
    cli.then("simulate replay", c=campaign)


Folder = Annotated[Path, arg("DIR", "A set made by 'calib challenge make'.")]
Cases = Annotated[Count, opt("N", "Only so many cases.", "--cases", min=1)]
Truth = Annotated[Place, opt("FILE", "The sealed truth; DIR.truth.json where not given.", "--truth")]


def make(
    seeds: Annotated[Path, opt("FILE", "How many cases of each kind, in TOML; see the manual.")],
    into: Annotated[Path, opt("DIR", "Folder for the set.")],
    cases: Cases = None,
    truth: Truth = None,
    workers: cli.Workers = 2,
) -> None:
    """Make sealed cases: first the truth, in one file apart whose hash is stored, then the campaigns.

    Example: calib challenge make --seeds tests/challenge/seeds/development.toml --into blind --cases 40
    """
    from calib.challenge import make

    def say_sealed(digest: str) -> None:
        cli.say(f"truth sealed, SHA-256 {digest}")

    force = cli.forced()
    with cli.progress("making") as tick:
        sealed_set = make(seeds, into, cases, truth, workers=workers, force=force, progress=tick, sealed=say_sealed)
    cli.say(f"{sealed_set.cases} cases in {sealed_set.folder}, truth apart in {sealed_set.truth}")
    cli.then("challenge make", c=into)
    cli.emit_json(plain(sealed_set))


def run(folder: Folder, cases: Cases = None, workers: cli.Workers = 2, seed: cli.Seed = 0) -> None:
    """Diagnose every case that has no verdict yet; the truth is not opened.

    Example: calib challenge run blind
    """
    from calib.challenge import run as run_set

    cli.keep(f"the verdicts so far, in {folder}; the same command goes on")
    with cli.progress("diagnosing") as tick:
        ran = run_set(folder, workers=workers, seed=seed, limit=cases, progress=tick)
    cli.say(f"{ran.done} cases diagnosed, {ran.skipped} had a verdict already, {ran.failed} ended in an error")
    cli.then("challenge run", c=folder)
    cli.emit_json(plain(ran))


def score(
    folder: Folder,
    truth: Truth = None,
    plot: Annotated[Place, opt("FILE", "PNG, SVG or PDF; the confusion matrix goes beside it.")] = None,
) -> int:
    """Open the truth once, check its hash, and score the verdicts. Exit status 1 where a target is missed.

    Example: calib challenge score blind --plot blind.png --json blind-score.json
    """
    from calib.challenge.score import score as score_set
    from calib.reporting.topics.simulation import score_content

    beside = None if plot is None else plot.parent / f"{plot.stem}-confusion{plot.suffix}"
    cli.refuse_outputs(plot, beside)
    scored = score_set(folder, truth_file=truth)
    cli.show(score_content(scored))
    if plot is not None and beside is not None:
        from calib.reporting.figures import save
        from calib.reporting.figures.studies import board_figure, confusion_figure

        save(board_figure(scored), plot, force=cli.forced())
        save(confusion_figure(scored), beside, force=cli.forced())
        cli.wrote([plot, beside])
    cli.then("challenge score", c=folder)
    cli.emit_json(scored.to_dict())
    return 1 if any(scored.meets(line) is False for line in scored.board) else 0


def own(
    folder: Annotated[Path, arg("CAMPAIGN", "Folder with campaign.toml, runs.csv, logs.")],
    effects: Annotated[Text, opt("A,B", "Effects to plant; all that the runs can show by default.")] = None,
    sizes: Annotated[
        str, opt("LIST", "10s: a signal of 10; 2x: twice the typical size; 0.01: in its unit.")
    ] = "5s,10s,25s",
    planted: Annotated[int, opt("N", "How often each effect and size is planted.", min=1)] = 5,
    workers: cli.Workers = 2,
    seconds: Annotated[float, opt("S", "Begin no diagnosis after so long.", min=1.0)] = 900.0,
    seed: cli.Seed = 0,
) -> int:
    """Plant known effects on this campaign's own noise and route, and say what its data would find.

    Exit status 1 where false alarms, or wrong names, are surely more than one in twenty.

    Example: calib challenge own sample_runs/yard --effects track_width,temperature_radius --planted 3
    """
    from calib.campaign.read import read_campaign
    from calib.challenge.own_runs import challenge_own, parse_sizes
    from calib.reporting.topics.simulation import own_content

    names = tuple(filter(None, map(str.strip, (effects or "").split(","))))
    if effects is not None and not names:
        raise BadInputError(f"--effects: found {effects!r}; expected effects with commas; 'calib effects' lists them")
    how = {"planted": planted, "workers": workers, "seed": seed}
    sized, campaign = parse_sizes(sizes), read_campaign(folder)
    with cli.progress("planting") as tick:
        own_score = challenge_own(campaign, names, sized, seconds=seconds, progress=tick, **how)
    if own_score.done < own_score.asked:
        cli.note(
            f"{seconds:g} s were enough for {own_score.done} of {own_score.asked} diagnoses; for more, raise --seconds"
        )
    cli.show(own_content(own_score))
    cli.then("challenge own", c=folder)
    cli.emit_json(own_score.to_dict())
    return 0 if own_score.trusted else 1
