"""What laboratories call things, in English and German: guesses of which column is which, for a proposed mapping."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from calib.campaign.columns import recognise, spelled
from calib.campaign.ingest.mapping import TABLE_COLUMNS
from calib.campaign.model import LOG_COLUMNS
from calib.units import SUFFIXES, split_suffix

_COUNTS: Final = r"(impuls|count|enc|tick|inkrement|increment|zaehl|pulse|wheel|rad_|joint|drehgeber)"

#: column of the run table -> what its name may look like, letters lower and umlauts spelt out
_TABLE: Final[Sequence[tuple[str, str]]] = (
    ("run_id", r"(run|lauf|fahrt|messung|versuch|trial|test)(_?(id|no|nr|nummer|number|name))?\.?|nr\.?|id"),
    ("session", r"(sitzung|session|schicht|serie|messtag|tag|day)(_?(id|nr|no))?"),
    ("direction", r".*(richtung|direction|heading_of_run)"),
    ("kind", r"(art|route|kurs|course|kind|type|typ|streckenart|manoever|path)"),
    ("load_left_N", r"(rad)?last_?(li|links|left|l)|(wheel_)?load_(left|l)|f_?(left|l)"),
    ("load_right_N", r"(rad)?last_?(re|rechts|right|r)|(wheel_)?load_(right|r)|f_?(right|r)"),
    ("payload_x_m", r"(payload|last|zuladung|ladung|nutzlast)_?(x|vorn.*|laengs)|(abstand|lage)_?(vorn.*|x|laengs)"),
    ("payload_y_m", r"(payload|last|zuladung|ladung|nutzlast)_?(y|quer)|(versatz|quer|lage_?y).*"),
    ("payload_kg", r"(zuladung|nutzlast|beladung|ladung|payload|masse|mass|gewicht|load|last)"),
    ("speed_mps", r"(geschw.*|speed.*|velocity|tempo|v_?soll|v)"),
    ("temperature_C", r"temp.*"),
    ("minutes_under_load", r"(standzeit|minutes?_under_load|dwell.*)"),
    ("distance_m", r"(strecke|distanz|distance|weg|laenge|length|s_?o)(_.*)?"),
    ("counts_left", _COUNTS + r".*_?(l|li|links|left)"),
    ("counts_right", _COUNTS + r".*_?(r|re|rechts|right)"),
    ("ref_x_m", r"(ref|mocap|tracker|end)_?x"),
    ("ref_y_m", r"(ref|mocap|tracker|end)_?y"),
    ("ref_theta_rad", r"(ref|mocap|tracker|end)_?(theta|yaw|heading|winkel)"),
    ("excluded", r"(excluded|ungueltig|ausschluss|ausgeschlossen)"),
)
_LOG: Final[Sequence[tuple[str, str]]] = (
    ("t_s", r"(t|time|zeit|timestamp|zeitstempel|stamp|uhrzeit|datum_?zeit)(_.*)?"),
    ("counts_front_left", r".*(front_?(l|left)|v_?l|vorn.*links)"),
    ("counts_front_right", r".*(front_?(r|right)|v_?r|vorn.*rechts)"),
    ("counts_rear_left", r".*((rear|back)_?(l|left)|h_?l|hinten.*links)"),
    ("counts_rear_right", r".*((rear|back)_?(r|right)|h_?r|hinten.*rechts)"),
    ("counts_front", _COUNTS + r".*_?(front|vorn|vorne|v)"),
    ("counts_left", r"(" + _COUNTS + r".*_?)?(l|li|links|left)"),
    ("counts_right", r"(" + _COUNTS + r".*_?)?(r|re|rechts|right)"),
    ("steer_rad", r".*(steer|lenk).*"),
    ("range_m", r".*(laser|range|abstand|entfernung|distan[cz]|weg|strecke).*"),
    ("ref_x_m", r"((ref|mocap|pose|pos|tracker)_?)?x(_?true)?"),
    ("ref_y_m", r"((ref|mocap|pose|pos|tracker)_?)?y"),
    ("ref_theta_rad", r"((ref|mocap|pose|pos|tracker)_?)?(theta|yaw|heading|gier.*)"),
)

#: what ways along a corridor are called -> out or back
DIRECTION_WORDS: Final = {
    **dict.fromkeys(("out", "hin", "vor", "vorwaerts", "hinfahrt", "hinweg", "forward", "there", "a", "ab"), "out"),
    **dict.fromkeys(("back", "zurueck", "rueck", "rueckwaerts", "rueckfahrt", "rueckweg", "return", "b", "ba"), "back"),
}


def plain(text: str) -> str:
    """Return a text in lower case with umlauts spelt out."""
    out = text.strip().lower()
    for letter, spelt in (("ä", "ae"), ("ö", "oe"), ("ü", "ue"), ("ß", "ss")):
        out = out.replace(letter, spelt)
    return out


def stem_and_unit(name: str) -> tuple[str, str | None]:
    """Return a column's name without its unit, plain, and the unit where it names one that calib knows.

    `name`: as found, for example ``Strecke [mm]`` or ``Weg in mm``.
    """
    in_words = re.sub(r"\s+in\s+(\S+)\s*$", r" [\1]", name.strip())
    stem, unit = split_suffix(spelled(in_words))
    return plain(re.sub(r"[.\s]+", "_", stem)).strip("_"), unit


def _guess(name: str, words: Sequence[tuple[str, str]], known: Sequence[str]) -> tuple[str, str | None] | None:
    exact = recognise(name, known).name
    if exact in known:
        return exact, None
    stem, unit = stem_and_unit(name)
    for target, pattern in words:
        if re.fullmatch(pattern, stem):
            suffix = split_suffix(target)[1]
            if unit is None or target.startswith("counts_"):
                return target, None
            if suffix is not None and SUFFIXES[unit][0] == suffix:
                return target, unit
    return None


def guessed_table_column(name: str) -> tuple[str, str | None] | None:
    """Return the column of the run table that a name may stand for, and its unit, or None."""
    return _guess(name, _TABLE, TABLE_COLUMNS)


def guessed_log_column(name: str) -> tuple[str, str | None] | None:
    """Return the column of a log that a name may stand for, and its unit, or None.

    `name`: as found; of a recording's ``stream:column`` or ``group/channel`` the last part counts first.
    """
    last = re.split(r"[:/]", name)[-1]
    last = re.sub(r"^(position|velocity|effort)\.", "", last)
    return _guess(last, _LOG, LOG_COLUMNS) or _guess(re.sub(r"[:/.]+", "_", name).strip("_"), _LOG, LOG_COLUMNS)
