"""From a campaign to the laws of both wheels, checked against instruments, temperature and errors of the run table."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.special import chdtrc

from calib.campaign.check import doubts, implausible, notes_for_results
from calib.campaign.checks import MAX_LOAD_R2, assumed_settings, listed, partial_slope
from calib.campaign.checks.measurements import factor_reason, implausible_ratio
from calib.campaign.model import Campaign
from calib.campaign.settings import WHEEL_LOADS
from calib.campaign.wheels import steered_itself_m
from calib.errors import BadInputError, ImplausibleError, RefusedError
from calib.radius import effective, groups_of, regression
from calib.radius.checks import MAX_CELLS, with_checks, without_loads
from calib.radius.deviation import weave_checks, with_path_check
from calib.radius.effective import EffectiveRadii, effective_radii
from calib.radius.order import aliasing_with_load
from calib.radius.regression import FAIL_BELOW, FAILED, NOTE, OK, UM, Check, WheelFit, fit_wheel, t_check, t_quantile
from calib.radius.result import PLAUSIBLE, Fit, Setup
from calib.types import FloatArray, IntArray, StrArray, few_digits

#: largest reference load over the largest driven; beyond, rounding takes all digits
MAX_REFERENCE_RATIO: Final = 1e4
#: largest plausible change with load, and scatter of runs, as shares of the radius
MAX_LOAD_CHANGE: Final = 0.2
MAX_SCATTER: Final = 0.03
#: smallest range of temperatures that the temperature check is made for
MIN_SPAN_K: Final = 1.0
#: usual relative change of a radius with temperature, 0.1 % in 20 K
USUAL_PER_K: Final = 5e-5
#: usual relative error of a wheel load
WEIGHING_ERROR: Final = 0.01
#: smallest spread of the runs' lengths for their check, in standard uncertainties of a distance
MIN_LENGTH_SPREAD: Final = 30.0
#: checks that, failed, explain a scatter beyond the instruments'
EXPLAINED_BY: Final = ("lack_of_fit", "curvature", "influence", "run_length")
#: relative error of a radius by a path that 'calib deviation' tolerates
PATH_TOLERANCE: Final = 5e-4
#: a law that leaves more than this share of the held-out runs' scatter explains less than 3/4 of its variance
MAX_SHARE_LEFT: Final = 0.5
EXCHANGED: Final = "the loads, or else the counts, of left and right exchanged in all runs"
#: rounds of choosing each run's reading and fitting the laws; a few converge
ROUNDS: Final = 20
#: columns whose range a result states
CONDITIONS: Final = (
    "distance_m", "speed_mps", "temperature_C", "payload_kg", "payload_x_m", "payload_y_m", "minutes_under_load",
    "load_left_N", "load_right_N",
)  # fmt: skip


def fit_law(radii: EffectiveRadii, *, reference_load_N: float, name: str = "", simulated: bool = False) -> Fit:
    """Fit both wheels' laws to effective radii, with their checks.

    `reference_load_N`: load on which the coefficients are centred. Raises RefusedError with fewer than three runs.
    """
    wheels = []
    for side in ("left", "right"):
        load, radius, std = (getattr(radii, column.format(side)) for column in ("load_{}_N", "radius_{}_m", "std_{}_m"))
        unchecked = fit_wheel(side, load, radius, radii.session, reference_load_N=reference_load_N)
        checked = with_checks(unchecked, radii.session, radii.direction, radii.run_id)
        wheels.append(with_instrument_checks(checked, radii.distance_m, std, radii.session))
    of_weave = tuple(weave_checks(radii, wheels))
    wheels = [replace(wheel, checks=(*wheel.checks, *of_weave)) for wheel in with_reading_checks(radii, wheels)]
    radii = replace(radii, budget=(*radii.budget, *effective.observed_components(radii, *wheels)))
    return Fit(name, simulated, wheels[0], wheels[1], radii, notes=radii.notes)


def fit_campaign(campaign: Campaign, *, reference_load_N: float | None = None, noted: bool = True) -> Fit:
    """Return the fit of a campaign: radii, both laws, static radii (``static_radius_left_m``) where measured.

    `reference_load_N`: see `fit_law`; None: the model's; `noted`: with the campaign's notes. Raises RefusedError where
    fewer than three runs can be used; ImplausibleError where units or settings are the reason.
    """
    reference = campaign.model.reference_load_N if reference_load_N is None else reference_load_N
    if not np.isfinite(reference) or reference < 0:
        raise BadInputError(f"reference load: found {reference:g} N; expected a load of zero or more; correct it")
    findings = [f"{note.where}: {note.text}" for note in implausible(campaign)]
    try:
        radii = effective_radii(campaign)
        largest = float(np.max([radii.load_left_N, radii.load_right_N], initial=1.0))
        if reference > MAX_REFERENCE_RATIO * largest:
            expected = f"a load near those driven, up to {largest:g} N"
            raise BadInputError(f"reference load: found {reference:g} N; expected {expected}; correct it")
        fit = fit_law(radii, reference_load_N=reference, name=campaign.name, simulated=campaign.simulated)
    except RefusedError as error:
        if findings:
            raise ImplausibleError(campaign.name, findings) from error
        raise
    sources = effective.declared_sources(campaign)
    used = campaign.select(np.isin(campaign.runs.run_id, radii.run_id)).runs
    nominal = None if "vehicle.wheel_radius_m" in campaign.assumed else campaign.vehicle.wheel_radius_m
    weighed = any(np.isfinite(campaign.runs.number(f"load_{side}_N")).any() for side in ("left", "right"))
    wheels, doubtful = {}, [Check("data", FAILED, sentence) for sentence in doubts(campaign)]
    for name, line in fit.wheels.items():
        wheel = effective.with_systematic(line if weighed else without_loads(line), radii, sources)
        wheel = replace(wheel, checks=(*_implausible(wheel, findings, nominal, radii.run_id), *doubtful, *wheel.checks))
        wheel = with_temperature_check(wheel, used.number("temperature_C"), used.label("session"))
        if weighed and not any(source.section == "weighing" for source in sources):
            wheel = _with_weighing_check(wheel)
        if not any(source.section == "path" for source in sources) and np.isnan(used.number("ref_theta_rad")).all():
            # a bow h turns the vehicle by 8 h / S: each wheel's path changes by half the track times that
            per_bow = 4.0 * campaign.vehicle.track_m * wheel.radius_m / radii.distance_m**2
            wheel = with_path_check(wheel, float(per_bow.mean()), steered_itself_m(campaign))
        wheels[name] = wheel
    static, notes = _static(campaign, reference)
    stated = (campaign.vehicle, campaign.encoder, campaign.model, campaign.rangefinder, campaign.reference)
    driven = {name: column for name in CONDITIONS if np.isfinite(column := used.number(name)).any()}
    unweighed = {} if weighed else dict.fromkeys(WHEEL_LOADS, f"{fit.left.law.reference_load_N:.4g} N")
    conditions = {name: (float(np.nanmin(column)), float(np.nanmax(column))) for name, column in driven.items()}
    budget = (*fit.radii.budget, *effective.systematic_components(wheels, radii, sources))
    setup = Setup(*stated, conditions, assumed_settings(campaign) | unweighed)
    notes = (*(notes_for_results(campaign) if noted else ()), *fit.notes, *notes)
    fit = replace(fit, radii=replace(fit.radii, budget=budget), static=static, notes=notes, setup=setup)
    return replace(fit, left=wheels["left"], right=wheels["right"])


def _static(campaign: Campaign, reference_load_N: float) -> tuple[dict[str, WheelFit], tuple[str, ...]]:
    runs = campaign.included().runs
    fits, notes = {}, []
    for wheel in ("left", "right"):
        radius, load = runs.number(f"static_radius_{wheel}_m"), runs.number(f"load_{wheel}_N")
        good = np.isfinite(radius) & np.isfinite(load)
        labels = runs.label("session")[good], runs.label("direction")[good], runs.run_id[good]
        try:
            if good.any():
                unchecked = fit_wheel(wheel, load[good], radius[good], labels[0], reference_load_N=reference_load_N)
                fits[wheel] = with_checks(unchecked, *labels)
        except RefusedError as error:
            notes.append(f"Static radius not fitted: {error}.")
    return fits, tuple(notes)


def _implausible(wheel: WheelFit, findings: list[str], nominal_m: float | None, runs: StrArray) -> tuple[Check, ...]:
    other = "right" if wheel.wheel == "left" else "left"
    own = [text for text in findings if f"the {other} wheel" not in text]
    radius_named = any(f"the {wheel.wheel} wheel's radius" in text for text in own)
    texts = dict.fromkeys([*own, *_beyond_bounds(wheel, nominal_m, runs, radius_named=radius_named)])
    return tuple(Check(PLAUSIBLE, FAILED, text if text.endswith((".", "?")) else f"{text}.") for text in texts)


def _beyond_bounds(wheel: WheelFit, nominal_m: float | None, runs: StrArray, *, radius_named: bool) -> Iterator[str]:
    radius = wheel.law.radius_ref_m
    if not (np.isfinite(radius) and radius > 0):
        yield f"the radius at the reference load comes out as {radius:.4g} m; expected one above zero; check the loads"
        return
    if nominal_m is not None and implausible_ratio(radius / nominal_m) and not radius_named:
        yield (
            f"the radius comes out {radius / nominal_m:.2f} times nominal ({1e3 * radius:.4g} mm for "
            f"{1e3 * nominal_m:.4g} mm): {factor_reason(radius / nominal_m)}"
        )
    change = wheel.law.slope_m_per_N * (wheel.law.load_max_N - wheel.law.load_min_N) / radius
    if wheel.model == "line" and abs(change) > MAX_LOAD_CHANGE:
        yield (
            f"load changes the radius by {100 * change:.3g} % over the loads driven; expected less than "
            f"{100 * MAX_LOAD_CHANGE:.0f} %; check loads and distances"
        )
    if wheel.run_std_m > MAX_SCATTER * radius:
        yield (
            f"single runs scatter by {100 * wheel.run_std_m / radius:.2g} % of the radius; expected less than "
            f"{100 * MAX_SCATTER:.0f} %; check distances, counts and loads, first of "
            f"{runs[int(np.argmax(np.abs(wheel.residual_m)))]}, or exclude it"
        )


def with_instrument_checks(fit: WheelFit, distance_m: FloatArray, std_m: FloatArray, session: StrArray) -> WheelFit:
    """Return `fit` with checks of run length and scatter; `std_m` (n_runs,): of each radius by the instruments."""
    std, basis = np.nan_to_num(std_m), fit.design_basis(session)
    checks = [*fit.checks, *_run_length(fit, fit.radius_m.mean() / distance_m, std, basis)]
    if not any(check.level == FAILED and check.name in EXPLAINED_BY for check in checks):
        checks += scatter_check(fit, std, session)
    return replace(fit, checks=tuple(checks))


def _run_length(fit: WheelFit, offset_gain: FloatArray, std_m: FloatArray, basis: FloatArray) -> Iterator[Check]:
    # offset_gain: radius over distance, the change of a radius by a constant error of the distances
    own, residual = (values - basis @ (basis.T @ values) for values in (offset_gain, fit.residual_m))
    norm, dof, mean = float(own @ own), len(own) - basis.shape[1] - 1, float(offset_gain.mean())
    least = MIN_LENGTH_SPREAD * mean * float(np.sqrt(np.mean(std_m**2)) / fit.radius_m.mean())
    if dof < regression.MIN_SLOPE_DOF or np.std(offset_gain) <= least:
        return
    if np.sqrt(norm / len(own)) <= least:
        hidden = "The lengths of the runs follow loads or sessions, which hides a constant error of the distances; "
        yield Check("run_length", NOTE, f"{hidden}drive each load over the same lengths.")
        return
    offset = float(own @ residual) / norm
    # HC3, since short runs may scatter more; no less than the instruments
    slack = np.maximum(1.0 - np.sum(basis**2, axis=1) - own**2 / norm, 1.0 / len(own))
    spreads = [np.linalg.norm(own * error) for error in ((residual - offset * own) / slack, std_m)]
    sd = float(max(spreads)) / norm
    # a few short runs among many long ones: the dof are theirs
    dof = min(float(dof), norm**2 / float(np.sum(own**4)))
    half = sd * float(t_quantile(dof))
    sentences = (
        "Short and long runs give the same radius.",
        f"The distances seem to be off by a constant {1e3 * offset:+.3g} mm ({1e3 * (offset - half):+.3g} to "
        f"{1e3 * (offset + half):+.3g}), and the law by {UM * offset * mean:+.3g} um: short runs give other radii. "
        "Check the rangefinder's zero, and slip at start and stop; correct distance_m, or drive long runs alone.",
    )
    fails = abs(offset * mean) > float(fit.estimate.half_width((1.0, 0.0)))
    yield t_check("run_length", offset, sd, dof, sentences, fails=fails)


def _with_weighing_check(fit: WheelFit) -> WheelFit:
    # runs of a load that was weighed once share its error
    loads_N, n_runs = np.unique(fit.load_N, return_counts=True)
    if fit.model != "line" or (n_runs < 2).any():
        return fit
    lever = n_runs * (loads_N - fit.load_N.mean()) / np.sum((fit.load_N - fit.load_N.mean()) ** 2)
    share = float(np.linalg.norm(lever * WEIGHING_ERROR * loads_N))
    if abs(fit.law.slope_m_per_N) * share < fit.law.std_of((0.0, 1.0)):
        return fit
    sentence = (
        f"{len(loads_N)} loads stand for {len(fit.load_N)} runs, as if weighed once or computed: errors of "
        f"{100 * WEIGHING_ERROR:.0f} % move the slope by {100 * share:.2g} %, which no interval holds; weigh each run, "
        "or declare weighing.scale under [uncertainty]."
    )
    return replace(fit, checks=(*fit.checks, Check("weighing", NOTE, sentence)))


def with_temperature_check(fit: WheelFit, temperature_C: FloatArray, session: StrArray) -> WheelFit:
    """Return `fit` with the check against temperature, (n_runs,), NaN where not read."""
    known = np.isfinite(temperature_C)
    if not known.any() or (span := float(np.ptp(temperature_C[known]))) < MIN_SPAN_K:
        return fit
    residual, least = fit.residual_m[known], 0.1 * MIN_SPAN_K
    slope, sd, dof = partial_slope(residual, temperature_C[known], fit.design_basis(session, known), least)
    if sd <= 0.0:
        return fit
    limit, usual = abs(slope) + sd * float(t_quantile(dof)), USUAL_PER_K * fit.law.radius_ref_m
    sentences = (
        f"The radius follows the temperature by no more than {UM * limit:.2g} um/K, if at all.",
        f"The radius follows the temperature by {UM * slope:+.2g} um/K over {span:.0f} K driven: the law is off by "
        "that on a warmer or colder day; 'calib diagnose' says whether it is the temperature, and corrects it.",
    )
    check = t_check("temperature", slope, sd, dof, sentences, fails=True)
    with_load, per_N = aliasing_with_load(fit, temperature_C, session)
    moved = usual * abs(per_N)
    if limit > usual and check.passed and with_load**2 > MAX_LOAD_R2 and moved > fit.law.std_of((0.0, 1.0)):
        text = (
            f"Load and temperature go together (correlation {with_load:+.2f}, {span:.0f} K): a usual {UM * usual:.2g} "
            f"um/K may not show, and moves the slope by {UM * moved:.2g} um/N; drive light and heavy warm and cold."
        )
        check = Check("temperature", FAILED, text)
    elif np.isinf(sd):
        return fit
    return replace(fit, checks=(*fit.checks, check))


def scatter_check(fit: WheelFit, std_m: FloatArray, session: StrArray) -> Iterator[Check]:
    """Yield the check of the scatter against the instruments' standard uncertainties `std_m` (n_runs,)."""
    dof = len(std_m) - fit.design_basis(session).shape[1]
    stated, scatter = float(np.sqrt(np.mean(np.nan_to_num(std_m) ** 2))), fit.run_std_m
    if dof < regression.MIN_SLOPE_DOF or stated <= 0.0:
        return
    ratio, least = scatter / stated, max(PATH_TOLERANCE * float(fit.radius_m.mean()), stated)
    p_value, level = float(chdtrc(dof, dof * ratio**2)), OK
    finding = p_value < regression.NOTE_BELOW and scatter**2 > stated**2 + least**2
    sentence = "Runs scatter no more than a straight path lets them."
    if finding:
        level, times = NOTE, f"{ratio:.{0 if ratio >= 10.0 else 1}f} times"
        sentence = (
            f"Runs scatter by {UM * scatter:.3g} um, {times} what rangefinder and counters explain: the cause (a "
            "weave, slip) is not known, and may move the law by as much, which no interval holds; add logs, or "
            "amplitude_m and wavelength_m."
        )
    # what a tolerated path may add is no finding
    yield Check("scatter", level, sentence, ratio, "scatter over stated", p_value if finding else None)


def with_reading_checks(radii: EffectiveRadii, wheels: list[WheelFit]) -> list[WheelFit]:
    """Return the wheels' fits, failed where runs scatter beyond instruments and paths and the loads do not explain it.

    They do not where the law leaves most of held-out runs' scatter, or another reading far less.
    """
    scatters = [[*scatter_check(wheel, getattr(radii, f"std_{wheel.wheel}_m"), radii.session)] for wheel in wheels]
    noted = any(check.level == NOTE for part in scatters for check in part)
    if not noted or any(one.model == "constant" for one in wheels):
        return wheels
    other, judged = _better_reading(radii), []
    # one run far off alone is not read better by any load
    far = int(np.argmax(np.sum([np.abs(wheel.residual_m) for wheel in wheels], axis=0)))
    columns = ("run_id", "session", "load_left_N", "load_right_N", "radius_left_m", "radius_right_m")
    others: dict[str, Any] = {name: np.delete(getattr(radii, name), far) for name in columns}
    if "loads of other runs" in other and not _better_reading(replace(radii, **others)):
        other = ""
    for wheel, scatter in zip(wheels, scatters, strict=True):
        left_m, before_m = _held_out_scatter_m(wheel, radii)
        if any(check.level == NOTE for check in scatter) and (other or left_m > MAX_SHARE_LEFT * before_m):
            worst = ", ".join(radii.run_id[np.argsort(-np.abs(wheel.residual_m))][:3])
            remedy = f"hold loads, counts and distances against the notes of the day, first of {worst}"
            sentence = (
                f"the loads do not explain the {wheel.wheel} wheel's radii: the law leaves {few_digits(UM * left_m)} "
                f"of {few_digits(UM * before_m)} um of runs held out, {scatter[0].statistic:.0f} times what "
                "instruments explain"
            )
            checks = (Check(PLAUSIBLE, FAILED, f"{sentence}; {other or remedy}"), *wheel.checks)
            wheel = replace(wheel, checks=tuple(check for check in checks if check.name != "scatter"))
        judged.append(wheel)
    return judged


def _held_out_scatter_m(wheel: WheelFit, radii: EffectiveRadii) -> tuple[float, float]:
    # scatter about the other runs' fit, with and without the law, beside one mean or one a session, as suits the law
    pairs = []
    for means in (np.ones((len(radii), 1)), groups_of(radii.session).indicators):
        sizes = []
        for columns in (np.column_stack((means, wheel.load_N)), means):
            basis = np.linalg.qr(columns)[0]
            slack = np.maximum(1.0 - np.sum(basis**2, axis=1), 1.0 / len(radii))
            sizes.append(float(np.std((wheel.radius_m - basis @ (basis.T @ wheel.radius_m)) / slack)))
        pairs.append((sizes[0], sizes[1]))
    return min(pairs, key=lambda pair: pair[0] / max(pair[1], 1e-300))


def _better_reading(radii: EffectiveRadii) -> str:
    # p-value of a reading: ratio of squares to the power of half their dof, times the readings
    loads = np.column_stack((radii.load_left_N, radii.load_right_N)) / float(np.max(radii.load_left_N))
    radius = np.column_stack((radii.radius_left_m, radii.radius_right_m))
    days, n = groups_of(radii.session).indicators, len(loads)
    dof = n - days.shape[1] - 1
    pairs: FloatArray = np.unique(np.round(np.vstack((loads, loads[:, ::-1])), 2), axis=0).astype(np.float64)
    readings: dict[str, tuple[FloatArray, FloatArray]] = {
        "the loads of left and right exchanged": (loads[:, ::-1][None], radius),
        "the counts of left and right exchanged": (loads[None], radius[:, ::-1]),
        "the loads of the row before": (np.roll(loads, 1, axis=0)[None], radius),
        "the loads of the row after": (np.roll(loads, -1, axis=0)[None], radius),
        "loads of other runs": (np.repeat(pairs[:, None], n, axis=1), radius),
    }
    unlike = np.abs(loads[:, 0] - loads[:, 1]) > regression.SAME_LOAD
    stated = _squares(loads[None], radius[None], days, np.zeros(n))[0]
    better = []
    for name, (other, moved) in readings.items() if dof > 0 and len(pairs) <= MAX_CELLS else ():
        other = np.where(np.abs(other - loads) < regression.SAME_LOAD, loads, other)
        options, measured = np.concatenate((loads[None], other)), np.stack((radius, *[moved] * len(other)))
        starts = [np.zeros(n), np.ones(n), *days.T[:MAX_CELLS]]
        of_kind = []
        for start in starts if len(other) == 1 else _starts(loads, radius, pairs):
            square, chosen = _squares(options, measured, days, start)
            log_p = 0.5 * dof * np.log(max(square, 1e-300) / stated) + n * np.log(len(options))
            fewer = log_p + np.log(n) * np.count_nonzero(chosen)
            words = f"with {name} in {listed(radii.run_id[chosen > 0])}"
            # the same pairs of load and radius, for the other wheel
            whole = name.endswith(" of left and right exchanged") and (chosen[unlike] > 0).all()
            of_kind.append((fewer, log_p, square, f"with {EXCHANGED}" if whole else words))
        better += [min(of_kind)[1:]] if min(of_kind)[1] < np.log(FAIL_BELOW) else []
    if not better:
        return ""
    best, square, _ = min(better)
    likely = ", or ".join({words: 0 for log_p, _, words in sorted(better) if log_p + np.log(FAIL_BELOW) < best})
    scatter = UM * np.sqrt(square / (2 * dof))
    return f"read {likely}, they scatter by {scatter:.3g} um: correct the table by the notes of the day"


def _starts(loads: FloatArray, radius: FloatArray, pairs: FloatArray) -> list[FloatArray]:
    order = np.argsort(loads.sum(axis=1))
    nearest = 1.0 + np.argmin(np.abs(pairs[:, None] - loads[order]).sum(axis=2), axis=0)
    rank = np.argsort(np.argsort(radius.sum(axis=1)))
    return [nearest[rank], nearest[::-1][rank]]


def _squares(loads: FloatArray, radius: FloatArray, days: FloatArray, start: FloatArray) -> tuple[float, IntArray]:
    # residual squares of both laws and the best option of each run (n,), searched from `start`; loads and radii of the
    # options (n_options, n, 2), indicators of the days (n, n_sessions)
    runs, chosen = np.arange(loads.shape[1]), start.astype(np.int64)
    for _ in range(ROUNDS):
        squares = np.zeros(loads.shape[:2])
        for x, y in zip(np.moveaxis(loads, 2, 0), np.moveaxis(radius, 2, 0), strict=True):
            *shifts, slope = np.linalg.lstsq(np.column_stack((days, x[chosen, runs])), y[chosen, runs], rcond=None)[0]
            squares += (y - days @ shifts - slope * x) ** 2
        before, chosen = chosen, np.argmin(squares, axis=0)
        if (chosen == before).all():
            break
    return float(squares[before, runs].sum()), before
