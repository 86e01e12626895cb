"""What the report does not cover."""

from __future__ import annotations

from calib.report.blocks import Items, Section, Text
from calib.report.source import Source


def section(source: Source) -> Section:
    """Return the limits of the result, as they follow from these runs."""
    fit = source.fit
    items = [
        "The results relate only to the vehicle and wheels named above, in the condition in which they were driven.",
    ]
    for name, wheel in fit.wheels.items():
        if wheel.model == "line":
            items.append(
                f"{name.capitalize()} wheel: loads below {wheel.law.load_min_N:.0f} N and above "
                f"{wheel.law.load_max_N:.0f} N were not measured."
            )
        else:
            items.append(
                f"{name.capitalize()} wheel: only one load was measured; how the radius changes with load is not known."
            )
    if any(wheel.design == "confounded" for wheel in fit.wheels.values()):
        items.append(
            "Each session had a load of its own: a change from session to session cannot be told from an effect of "
            "load."
        )
    conditions = {} if fit.setup is None else fit.setup.conditions
    speed, hall = conditions.get("speed_mps"), conditions.get("temperature_C")
    items.append(
        "Other speeds than those driven"
        + ("" if speed is None else f" ({_range(speed, '.2g')} m/s)")
        + " and curves: the "
        "law comes from straight runs at constant speed; scrub and load transfer in curves are not contained in it."
    )
    items.append(
        "Other temperatures"
        + (", as none were recorded" if hall is None else f" than {_range(hall, '.1f')} °C")
        + ", later wear, other wheels and other floors."
    )
    items.append(
        "The track, and with it heading: straight runs do not determine it"
        + (" and the heading error of a vehicle needs it as well as the radii." if fit.setup is not None else ".")
    )
    return Section(
        "What this report does not cover",
        (
            Items(tuple(items)),
            Text(
                "This report may be passed on in full only. It is not a certificate, and makes no claim about the "
                "competence of the laboratory beyond what the laboratory states itself."
            ),
        ),
    )


def _range(pair: tuple[float, float], form: str) -> str:
    low, high = (format(value, form) for value in pair)
    return low if low == high else f"{low} to {high}"
