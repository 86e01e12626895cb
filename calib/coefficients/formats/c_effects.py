"""The law and the named effects of a coefficient file as one C99 header: wheel angles in, wheel travel out.

The same motion as `calib.runtime.Effects`, for the loop of a simulator in C or C++. Effects on readings, at places of
the floor, at stops and of the steering do not act on the wheels; the header names those of the file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, accepted_lines, ascii_line
from calib.coefficients.formats.c_header import C_LINKAGE, begin_header, c_number
from calib.coefficients.sections import EffectSection

#: see `calib.coefficients.formats`
AXLE_ONLY: Final = True

FILE_NAME: Final = "calib_effects.h"
#: forms that act through what a single run does not know, as in `calib.runtime.effects`
OTHER_FORMS: Final = ("change of load", "per session", "along the corridor alone", "other routes", "distance")


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the header of a coefficient file, with the law alone where it has no effects; `options` change nothing."""
    del options
    acting, others = _divided(file.effects)
    covariates = [section.effect.partition(":")[2] for section in acting if section.effect.startswith("covariate:")]
    blocks = [line for section in acting for line in _block(file, section, covariates)]
    lines = [*_head(file, acting, others), *_types(file, covariates), *_FUNCTIONS, *blocks, *_END]
    notes = (f"not in the header: {', '.join(others)}",) if others else ()
    return (Artifact(FILE_NAME, ("\n".join(lines) + "\n").encode("utf-8"), notes),)


def _divided(effects: Sequence[EffectSection]) -> tuple[list[EffectSection], list[str]]:
    """Return the effects that act on the wheels, and the names of the others."""
    acting, others = [], []
    for section in effects:
        known = section.effect.startswith("covariate:") or section.effect in _ACTS
        if known and not any(words in section.form for words in OTHER_FORMS):
            acting.append(section)
        else:
            others.append(section.effect)
    return acting, others


def _head(file: CoefficientFile, acting: Sequence[EffectSection], others: Sequence[str]) -> list[str]:
    about = [
        *(f"effect: {ascii_line(f'{section.effect} {section.form}'.strip())}" for section in acting),
        *(f"NOT in this header: {ascii_line(name)}, which does not act on the wheels" for name in others),
        *accepted_lines(file),
        "",
        "calib_effects e; calib_effects_run run = calib_effects_unknown();",
        "run.load_left_N = 420.0; run.load_right_N = 380.0; run.temperature_C = 14.0;",
        "calib_effects_begin(&e, &run);",
        "calib_effects_motion m = calib_effects_step(&e, d_left_rad, d_right_rad, dt_s);",
        "heading += m.turn_rad;",
    ]
    title = "Named effects on wheel motion, C99, for the loop of a simulator; no memory allocation, one header."
    return [
        *begin_header(file, title, about, "CALIB_EFFECTS_H", ("math.h",)),
        "#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__",
        "#error calib_effects.h tells unknown numbers by NaN: compile without -ffinite-math-only and -ffast-math",
        "#endif",
        "",
        *C_LINKAGE,
    ]


def _types(file: CoefficientFile, covariates: Sequence[str]) -> list[str]:
    """Return the lines of the constants and types."""
    constants = ("RADIUS_{}_M", "SLOPE_{}_M_PER_N", "REFERENCE_{}_N")
    wheels = [
        f"#define CALIB_EFFECTS_{constant.format(side)} {c_number(value)}"
        for side, wheel in (("LEFT", file.wheels.left), ("RIGHT", file.wheels.right))
        for constant, value in zip(constants, wheel.si("radius_ref", "slope", "reference_load").values(), strict=True)
    ]
    names = [f"    /* {number}: {ascii_line(name)} */" for number, name in enumerate(covariates)]
    return [
        *wheels,
        f"#define CALIB_EFFECTS_TRACK_M {c_number(file.vehicle.track.value)}",
        "/* the effects depend a little on the path that they bend: so often it is computed anew, as in a diagnosis */",
        "#define CALIB_EFFECTS_PASSES 3",
        "",
        "/* what holds during a run; numbers that are not known are NaN, and the effects through them then zero */",
        "typedef struct {",
        "    double load_left_N, load_right_N, payload_kg, temperature_C;",
        "    double speed_mps;          /* mean over the run's way */",
        "    double travelled_km;",
        "    double minutes_under_load; /* since the payload was put on, at the middle of the run */",
        "    int back;                  /* 1: driven back along a corridor */",
        "    double phase_left_rad, phase_right_rad; /* wheel angles at its start */",
        *(names and ["    /* further columns of the run table */", *names, f"    double covariate[{len(names)}];"]),
        "} calib_effects_run;",
        "",
        "/* travel of the wheels, track in this step, motion to the left, and change of heading */",
        "typedef struct { double left_m, right_m, track_m, aside_m, turn_rad; } calib_effects_motion;",
        "typedef struct { calib_effects_run run; double phase_left_rad, phase_right_rad; } calib_effects;",
        "",
        "static inline calib_effects_run calib_effects_unknown(void)",
        "{",
        "    calib_effects_run run = {0};",
        "    run.load_left_N = CALIB_EFFECTS_REFERENCE_LEFT_N;",
        "    run.load_right_N = CALIB_EFFECTS_REFERENCE_RIGHT_N;",
        "    run.temperature_C = run.speed_mps = run.travelled_km = run.minutes_under_load = (double)NAN;",
        *(f"    run.covariate[{number}] = (double)NAN;" for number in range(len(names))),
        "    return run;",
        "}",
        "",
    ]


_FUNCTIONS: Final = """\
/* how far a number lies from where an effect is zero; 0 where it is not known */
static inline double calib_effects_off(double value, double centre, double spread)
{
    const double off = (value - centre) / spread;
    return isfinite(off) ? off : 0.0;
}

/* no tighter than a turn about one rear wheel */
static inline double calib_effects_curvature(double way_m, double turn_rad)
{
    const double most = 2.0 / CALIB_EFFECTS_TRACK_M, way = fabs(way_m);
    const double curvature = way > 1e-6 ? turn_rad / way : 0.0;
    return fmax(-most, fmin(most, curvature));
}

static inline void calib_effects_begin(calib_effects *e, const calib_effects_run *run)
{
    e->run = *run;
    e->phase_left_rad = run->phase_left_rad;
    e->phase_right_rad = run->phase_right_rad;
}

/* the motion of a step in which the wheels turn by these angles */
static inline calib_effects_motion calib_effects_step(calib_effects *e, double d_left_rad, double d_right_rad,
                                                      double dt_s)
{
    const calib_effects_run *run = &e->run;
    const double radius_left = CALIB_EFFECTS_RADIUS_LEFT_M
        + CALIB_EFFECTS_SLOPE_LEFT_M_PER_N * (run->load_left_N - CALIB_EFFECTS_REFERENCE_LEFT_N);
    const double radius_right = CALIB_EFFECTS_RADIUS_RIGHT_M
        + CALIB_EFFECTS_SLOPE_RIGHT_M_PER_N * (run->load_right_N - CALIB_EFFECTS_REFERENCE_RIGHT_N);
    const double nominal_left = d_left_rad * radius_left, nominal_right = d_right_rad * radius_right;
    const double way = 0.5 * (nominal_left + nominal_right);
    const double nominal_turn = (nominal_right - nominal_left) / CALIB_EFFECTS_TRACK_M;
    const double speed = dt_s > 0.0 ? way / dt_s : 0.0;
    const double bend = calib_effects_curvature(way, nominal_turn);
    calib_effects_motion m = {nominal_left, nominal_right, CALIB_EFFECTS_TRACK_M, 0.0, nominal_turn};
    int pass;
    e->phase_left_rad += d_left_rad;
    e->phase_right_rad += d_right_rad;
    for (pass = 0; pass < CALIB_EFFECTS_PASSES; pass++) {
        const double curvature = calib_effects_curvature(0.5 * (m.left_m + m.right_m), m.turn_rad);
        double left = 0.0, right = 0.0, track = 0.0, aside = 0.0, turn = 0.0;
        (void)curvature;""".splitlines()

_END: Final = """\
        m.left_m = nominal_left * (1.0 + left);
        m.right_m = nominal_right * (1.0 + right);
        m.track_m = CALIB_EFFECTS_TRACK_M * (1.0 + track);
        m.aside_m = aside;
        m.turn_rad = (m.right_m - m.left_m) / m.track_m + turn;
    }
    (void)speed;
    (void)bend;
    return m;
}

#ifdef __cplusplus
}
#endif
#endif""".splitlines()


class _Sizes:
    """Sizes and settings of an effect as C numbers; 0 where the form lacks one."""

    def __init__(self, file: CoefficientFile, section: EffectSection) -> None:
        self.section, self.vehicle = section, file.vehicle
        self.reference_N = file.wheels.left.reference_load.value

    def __getitem__(self, name: str) -> str:
        return c_number(self.section.parameters[name].value if name in self.section.parameters else 0.0)

    def setting(self, name: str, default: float) -> str:
        return c_number(self.section.settings.get(name, default))

    def off(self, value: str) -> str:
        """Return how far a number of the run lies from where the effect is zero."""
        spread = self.section.settings.get("spread", 1.0) or 1.0
        return f"calib_effects_off({value}, {self.setting('centre', 0.0)}, {c_number(spread)})"

    @property
    def wheel(self) -> str:
        """Wheel that a form of one wheel acts on."""
        return "left" if self.section.form.startswith("left") else "right"


def _block(file: CoefficientFile, section: EffectSection, covariates: Sequence[str]) -> list[str]:
    """Return the statements of an effect in a scope of their own."""
    sizes = _Sizes(file, section)
    name, _, column = section.effect.partition(":")
    statements = _covariate(sizes, covariates.index(column)) if column else _ACTS[name](sizes)
    return [
        f"        {{ /* {ascii_line(section.effect)} */",
        *(f"            {line}" for line in statements),
        "        }",
    ]


def _both(value: str) -> list[str]:
    return [f"const double both = {value};", "left += both;", "right += both;"]


def _load_curve(s: _Sizes) -> list[str]:
    exponent = s.setting("exponent", 1.0)
    reference = s.setting("centre", s.reference_N)

    def shape(load: str) -> str:
        return f"{reference} * (pow(fmax({load}, 0.0) / {reference}, {exponent}) - 1.0) / {exponent}"

    return [
        f"left += {s['slope_left']} * ({shape('run->load_left_N')}) / radius_left;",
        f"right += {s['slope_right']} * ({shape('run->load_right_N')}) / radius_right;",
    ]


def _creep(s: _Sizes) -> list[str]:
    zero = s.setting("centre", 0.0)
    return [
        f"const double gone = exp(-run->minutes_under_load / {s.setting('tau_min', 1.0)});",
        "const double crept = isfinite(gone) ? 1.0 - gone : 0.0;",
        f"left -= {s['creep_left']} * (run->load_left_N - {zero}) * crept / radius_left;",
        f"right -= {s['creep_right']} * (run->load_right_N - {zero}) * crept / radius_right;",
    ]


def _curve_load(s: _Sizes) -> list[str]:
    vehicle = s.vehicle
    gravity, mass = c_number(vehicle.gravity.value), c_number(vehicle.mass.value)
    return [
        f"const double weight_N = {gravity} * ({mass} + run->payload_kg);",
        "const double pull_mps2 = speed * fabs(speed) * bend;",
        f"const double moved_N = weight_N * pull_mps2 * {c_number(vehicle.cog_z.value)}"
        f" / ({gravity} * CALIB_EFFECTS_TRACK_M);",
        f"left -= {s['slope']} * moved_N / radius_left;",
        f"right += {s['slope']} * moved_N / radius_right;",
    ]


def _drag(s: _Sizes) -> list[str]:
    there = "way >= 0.0" if "rolling" in s.section.form else "!run->back"
    return [f"{s.wheel} += {there} ? {s['relative']} : 0.0;"]


def _lost(s: _Sizes) -> list[str]:
    share = f"({s['share']} + {s['share_per_mps']})"
    if "speed_mps" not in s.section.settings:
        return [f"{s.wheel} += {share};"]
    over = f"run->speed_mps - {s.setting('speed_mps', 0.0)}"
    return [f"const double over = {over};", f"{s.wheel} += {share} * (over > 0.0 ? over : 0.0);"]


def _eccentric(s: _Sizes) -> list[str]:
    lines = []
    for side in ("left", "right"):
        lines += [
            f"const double half_{side} = 0.5 * d_{side}_rad;",
            f"const double middle_{side} = e->phase_{side}_rad - half_{side};",
            f"const double share_{side} = (half_{side} != 0.0 ? sin(half_{side}) / half_{side} : 1.0) / radius_{side};",
            f"{side} += ({s[f'{side}_cos']} * cos(middle_{side}) - {s[f'{side}_sin']} * sin(middle_{side}))"
            f" * share_{side};",
        ]
    return lines


def _covariate(s: _Sizes, number: int) -> list[str]:
    lines = [f"const double off = {s.off(f'run->covariate[{number}]')};"]
    if "both" in s.section.form:
        lines += _both(f"{s['relative_per_sd']} * off")
    elif "relative_per_sd" in s.section.parameters:
        lines.append(f"{s.wheel} += {s['relative_per_sd']} * off;")
    return [*lines, f"turn += {s['yaw_per_sd']} * off * way;"]


#: effect -> its statements
_ACTS: Final[dict[str, Callable[[_Sizes], list[str]]]] = {
    "temperature_radius": lambda s: _both(f"{s['alpha']} * {s.off('run->temperature_C')}"),
    "speed_radius": lambda s: _both(f"{s['per_mps']} * {s.off('run->speed_mps')}"),
    "wear": lambda s: [
        f"const double driven = {s.off('run->travelled_km')};",
        f"left += {s['rate_left']} * driven;",
        f"right += {s['rate_right']} * driven;",
    ],
    "radius_scale": lambda s: _both(s["relative"]),
    "unequal_radii": lambda s: [f"left -= 0.5 * {s['relative']};", f"right += 0.5 * {s['relative']};"],
    "track_width": lambda s: [f"track += {s['relative']};"],
    "load_radius": lambda s: [
        f"left += {s['slope_left']} * (run->load_left_N - {c_number(s.reference_N)}) / radius_left;",
        f"right += {s['slope_right']} * (run->load_right_N - {c_number(s.reference_N)}) / radius_right;",
    ],
    "load_radius_nonlinear": _load_curve,
    "load_creep": _creep,
    "load_dependent_track": lambda s: [
        f"track += {s['per_N']} * (run->load_left_N + run->load_right_N - 2.0 * {c_number(s.reference_N)});"
    ],
    "curve_scrub": lambda s: [f"track += {s['widening']} * fabs(curvature);"],
    "curve_load_transfer": _curve_load,
    "side_slip": lambda s: [f"aside -= {s['slip_per_acceleration']} * speed * speed * bend * way;"],
    "travel_direction": lambda s: _both(f"{s['relative']} * (run->back ? -1.0 : 1.0)"),
    "rear_drag": _drag,
    "lost_counts": _lost,
    "wheel_eccentricity": _eccentric,
}
