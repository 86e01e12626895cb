"""Check of a wheel's fit against the order driven: runs that follow each other, and the first of a session."""

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import stdtr, stdtrit

from calib.campaign.checks import MAX_LOAD_R2, covariate_against_load, partial_slope
from calib.radius import groups_of
from calib.radius.regression import FAILED, MIN_SLOPE_DOF, NOTE, NOTE_BELOW, OK, UM, Check, WheelFit, p_check, t_check
from calib.types import FloatArray, StrArray, floats

#: largest widening of a slope's interval by autocorrelation that passes: at a correlation of 0.8 and ascending loads it
#: covers 84 to 89 % instead of 95 %
MAX_SLOPE_WIDENING: Final = 1.25
#: root mean square of a column beside others that is rounding
ROUNDING: Final = 1e-9


def first_of_sessions(session: StrArray) -> FloatArray:
    """Return 1 for the first three runs of each session, or its first third, else 0, shape (n_runs,)."""
    groups = groups_of(session)
    number = np.cumsum(groups.index[:, None] == np.arange(len(groups)), axis=0)[np.arange(len(session)), groups.index]
    return floats(number <= np.minimum(groups.sizes[groups.index] // 3, 3))


def aliasing_with_load(fit: WheelFit, values: FloatArray, session: StrArray) -> tuple[float, float]:
    """Return `covariate_against_load` within sessions where the slope comes from there, else over all runs."""
    of = session if fit.design in {"crossed", "mixed"} else np.full(len(values), "")
    return covariate_against_load(fit.load_N, values, of) if fit.model == "line" else (0.0, 0.0)


def order_check(fit: WheelFit, session: StrArray) -> Check | None:
    """Return the check of the residuals against the order driven, first runs first; None with too few runs."""
    order, sloped = fit.autocorrelation, fit.design not in {"constant", "confounded"}
    follow, first = "", first_of_sessions(session)
    driven = {"rise or fall with the order driven": np.arange(float(len(session))), "of the first runs differ": first}
    for words, values in driven.items():
        if sloped and not follow and aliasing_with_load(fit, values, session)[0] ** 2 > MAX_LOAD_R2:
            follow = (
                f"Within the sessions the loads {words}: what drifts there (warming up, wear) looks like load, which "
                "no interval holds; drive the loads in random order."
            )
    level = NOTE if follow else OK
    of_first = _first_runs(fit, session, first, follow)
    if order is None or order.p_value == 1.0:
        return of_first if of_first.level != OK else Check("order", level, follow) if follow else None
    fails = sloped and order.slope_ratio > MAX_SLOPE_WIDENING
    alike = f"Runs that follow each other scatter alike (correlation about {order.rho:.2g})"
    alike += (
        f", and the loads follow the order driven: what lasts looks like load. The intervals are "
        f"{order.slope_ratio:.2g} times as wide for it, which is known roughly only; drive the loads in random order."
        if fails
        else f". {follow}"
        if follow
        else ": the intervals allow for it; let the wheels warm up, and drive the loads in random order."
    )
    sentences = (follow or "Runs that follow each other scatter independently.", alike)
    check = p_check("order", order.lag_one, "lag-one autocorrelation", order.p_value, sentences, fails=fails)
    if of_first.level != OK and check.level != FAILED:
        return of_first
    return replace(check, level=level) if check.level == OK else check


def _first_runs(fit: WheelFit, session: StrArray, first: FloatArray, follow: str) -> Check:
    # a bend of the law is no warming up
    beside = np.column_stack((fit.design_basis(session), (fit.load_N - fit.load_N.mean()) ** 2))
    off, sd, dof = partial_slope(fit.residual_m, first, beside, ROUNDING)
    moved, half = abs(off * aliasing_with_load(fit, first, session)[1]), float(fit.estimate.half_width((0.0, 1.0)))
    beyond = fit.model == "line" and moved > half
    slope = f" and the slope by {UM * moved:.2g} um/N{', more than its interval holds' * beyond}" if moved else ""
    side = "below the others, as where wheels warm up" if off < 0.0 else "above the others"
    finding = (
        f"The first runs of the sessions (three at most) lie {UM * abs(off):.2g} um {side}; they move the radius by "
        f"{UM * abs(off) * first.mean():.2g} um{slope}: drive the wheels warm first, then the loads in random order. "
        f"{follow}"
    ).strip()
    check = t_check("order", off, sd if dof >= MIN_SLOPE_DOF else np.inf, dof, ("", finding))
    return replace(check, level=FAILED) if beyond and check.level == NOTE else check


def step_check(fit: WheelFit, session: StrArray, run_id: StrArray) -> Check | None:
    """Return the check of a step between two sessions, or runs without sessions, or of a steady drift over all."""
    groups, n = groups_of(session), len(session)
    grouped = 2 <= len(groups) < n
    y = groups.means(fit.residual_m) if grouped else fit.residual_m
    y, k = y - y.mean(), len(y)
    dof = k - 2 - (fit.model == "line" and not grouped)
    if fit.design == "confounded" or dof < 2:
        return None
    before, drift = np.arange(1, k), np.arange(k) / (k - 1) - 0.5
    norm = np.append(before * (1.0 - before / k), drift @ drift)
    sizes = np.append(-np.cumsum(y)[:-1], y @ drift) / norm
    left = np.maximum(y @ y - sizes**2 * norm, 0.0)
    cut, names = int(np.argmin(left[:-1])), groups.names if grouped else run_id
    best = cut if left[cut] < left[-1] else -1
    # likelihood of a drift against that of the best of the steps, or of this against that
    if left[best] <= 0.0 or (left[best] / left[[cut, -1]].max()) ** (k / 2) * len(before) > NOTE_BELOW:
        return None
    size = float(sizes[best])
    said = f"by {UM * size:+.3g} um ({100 * size / fit.law.radius_ref_m:+.2g} %)"
    if best < 0:
        said = f"drifts {said} from {names[0]} to {names[-1]}, as by wear. The law is a mean: fit what was driven last"
    else:
        first = run_id[np.argmax(groups.index > cut)] if grouped else names[cut + 1]
        said = (
            f"steps {said} between {names[cut]} and {names[cut + 1]}: another wheel, tyre or encoder, or a rangefinder "
            f"remounted. The law is a mean of both: exclude the runs before {first}, or from it on, and fit again"
        )
    # off by more than a further run scatters
    fails = 0.5 * abs(size) > (fit.run_std_m if grouped else (left[best] / dof) ** 0.5) * stdtrit(dof, 0.975)
    t = size * float(norm[best] * dof / left[best]) ** 0.5
    p_value = min(float((len(before) if best >= 0 else 1) * 2.0 * stdtr(dof, -abs(t))), 1.0)
    check = p_check("step", t, f"t({dof})", p_value, ("", f"The radius {said}."), fails=bool(fails))
    return check if check.level != OK else None
