"""What columns may mean, by what laboratories and robots call things: English, German, French, Italian, Spanish."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final
from unicodedata import combining, normalize

from calib.campaign.ingest.mapping import COUNT_UNITS, TABLE_COLUMNS, unit_spelled
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.settings import recognise, spelled
from calib.units import SUFFIXES, split_suffix

_COUNTS: Final = (
    r"(impuls|count|enc|geber|tick|inkrement|increment|zaehl|pulse|wheel|rad_|joint|drehgeber|quad|q|odo|motor|raw)"
)
_PLACE: Final = r"(hallen|hall|boden|floor|luft|air|raum|room|ambient|umgebungs?|aussen|reifen|tyre|tire)"

#: column of the run table -> what its name may look like, letters lower and umlauts spelt out
_TABLE: Final[Sequence[tuple[str, str]]] = (
    (
        "run_id",
        r"(run|lauf|fahrt|messung|messfahrt|versuch|trial|test|drive)(_?(id|no|nr|nummer|number|name|#))?\.?|nr\.?|id|#"
        r"|(lfd|lauf)_nr|((n|no|num|numero)_)?(essai|mesure|passage|ensayo|prueba|corsa|prova|misura)|num|numero",
    ),
    (
        "session",
        r"(sitzung|session|schicht|serie|messtag|tag|day)(_?(id|nr|no))?|datum|date|messdatum"
        r"|jour|seance|fecha|sesion|data|giorno",
    ),
    ("direction", r".*(richtung|direction|heading_of_run)|way|dir|sens|sentido|direccion|senso|verso|direzione"),
    ("kind", r"(art|route|kurs|course|kind|type|typ|streckenart|manoever|path)"),
    (
        "load_left_N",
        r"(rad|wheel|waage|scale)?_?(last|load)?_?(links|left)|((rad|wheel)_?)?(last|load)_?(li|l)|f_?(left|l)",
    ),
    (
        "load_right_N",
        r"(rad|wheel|waage|scale)?_?(last|load)?_?(rechts|right)|((rad|wheel)_?)?(last|load)_?(re|r)|f_?(right|r)",
    ),
    (
        "payload_x_m",
        r"(payload|last|zuladung|ladung|nutzlast)_?(x|vorn.*|laengs)|(abstand|lage)_?(vorn.*|x|laengs)|x_(of_)?(the_)?(payload|load)",
    ),
    (
        "payload_y_m",
        r"(payload|last|zuladung|ladung|nutzlast)_?(y|quer)|(versatz|quer|lage_?y).*|y_(of_)?(the_)?(payload|load)",
    ),
    (
        "payload_kg",
        r"(zuladung|nutzlast|beladung|ladung|payload|masse|mass|gewicht|weight|load|last|massa)"
        r"|(charge|carga|carico)(_(utile|util))?"
        r"|(mass|masse|gewicht|weight)_(of_)?(the_)?(zuladung|nutzlast|ladung|payload|load|last)"
        r"|(zuladung|nutzlast|ladung|payload|load|last)s?_?(masse|mass|gewicht|weight)",
    ),
    ("speed_mps", r"((soll|set|mean)_?)?(geschw.*|speed.*|velocity|tempo|v_?soll|v)"),
    ("temperature_C", rf"({_PLACE}_?)?temp(eratur[ea]?)?(_.*)?"),
    ("minutes_under_load", r"(standzeit|minutes?_under_load|dwell.*)"),
    (
        "distance_m",
        r"((laser|mess|fahr|gemessene|measured|travelled|true|ref|reference|wahre)_?)?(strecke|distanz|distance|dist|weg|laenge|length|s_?o|longueur|trajet|distancia|recorrido|distanza|percorso)"
        r"(_.*)?|travel(led)?",
    ),
    ("counts_left", _COUNTS + r".*_?(l|li|links|left)"),
    ("counts_right", _COUNTS + r".*_?(r|re|rechts|right)"),
    ("ref_x_m", r"(ref|mocap|tracker|end|ziel|final)_?x"),
    ("ref_y_m", r"(ref|mocap|tracker|end|ziel|final)_?y"),
    (
        "ref_theta_rad",
        r"(ref|mocap|tracker|end|ziel|final)_?(theta|yaw|heading|winkel|kurs|kurswinkel)|theta|yaw|heading|kurswinkel",
    ),
    ("excluded", r"(excluded|ungueltig|ausschluss|ausgeschlossen)"),
)
#: what measures poses from outside, and what a speed is called
_TRACKER: Final = r"(ref|mocap|pose|pos|tracker|vicon|optitrack|qualisys|motive)"
_SPEED: Final = r"(vel|velocity|speed|geschwindigkeit)"
_LOG: Final[Sequence[tuple[str, str]]] = (
    ("t_s", r"(t|time|zeit|timestamp|zeitstempel|stamp|uhrzeit|datum_?zeit|epoch|unix(_?time)?)(_.*)?"),
    ("counts_front_left", r".*(front_?(l|left)|v_?l|vorn.*links)"),
    ("counts_front_right", r".*(front_?(r|right)|v_?r|vorn.*rechts)"),
    ("counts_rear_left", r".*((rear|back)_?(l|left)|h_?l|hinten.*links)"),
    ("counts_rear_right", r".*((rear|back)_?(r|right)|h_?r|hinten.*rechts)"),
    ("counts_front", _COUNTS + r".*_?(front|vorn|vorne|v)"),
    ("counts_left", r"(" + _COUNTS + r".*_?)?(l|li|links|left)"),
    ("counts_right", r"(" + _COUNTS + r".*_?)?(r|re|rechts|right)"),
    ("steer_rad", r".*(steer|lenk).*"),
    ("speed_rear_mps", rf"{_SPEED}_?(encoder|enc|rear|shaft|drive|antrieb)|(encoder|rear|shaft|drive)_?{_SPEED}"),
    ("range_m", r".*(laser|range|abstand|entfernung|distan[cz]|weg|strecke).*"),
    ("ref_x_m", rf"({_TRACKER}_?)?x(_?true)?"),
    ("ref_y_m", rf"({_TRACKER}_?)?y"),
    ("gyro_z_radps", r".*(angular_velocity_?z|gyro(_?z)?|yaw_?rate|gierrate|drehrate)"),
    ("ref_theta_rad", rf"({_TRACKER}_?)?(theta|yaw|heading|gier.*)"),
)
#: what stands behind the side in the name of a wheel: left_wheel_joint, wheel_left_joint, Enc_L_raw
_BEHIND: Final = re.compile(
    r"(_(joint|wheel|motor|axle|axis|pos|position|encoder|enc|counts?|cnt|ticks?|raw|geber|rad|drive|shaft|total))+$"
)
#: first letters of a robot's wheels: fl, rear_right_drive; 'rear' of two wheels is no axle of its own
_AXLE_FIRST: Final = re.compile(r"(?:^|_)(fl|fr|rl|rr|bl|br)$")
_CORNERS: Final = {
    **dict.fromkeys(("fl",), "counts_front_left"),
    **dict.fromkeys(("fr",), "counts_front_right"),
    **dict.fromkeys(("rl", "bl"), "counts_rear_left"),
    **dict.fromkeys(("rr", "br"), "counts_rear_right"),
}
_SIDES: Final = {
    "left": re.compile(r"(?:^|_)(l|li|left|links|linkes|linker|lhs)(?=_|$)"),
    "right": re.compile(r"(?:^|_)(r|re|right|rechts|rechtes|rechter|rhs)(?=_|$)"),
}

#: names of directions along a corridor -> out or back
DIRECTION_WORDS: Final = {
    **dict.fromkeys(
        (
            "out",
            "hin",
            "vor",
            "vorwaerts",
            "hinfahrt",
            "hinweg",
            "forward",
            "fwd",
            "there",
            "outbound",
            "a",
            "ab",
            "a->b",
            "aller",
            "ida",
            "andata",
            ">",
            "+",
        ),
        "out",
    ),
    **dict.fromkeys(
        (
            "back",
            "zurueck",
            "rueck",
            "rueckwaerts",
            "rueckfahrt",
            "rueckweg",
            "her",
            "return",
            "ret",
            "inbound",
            "retour",
        ),
        "back",
    ),
    **dict.fromkeys(("retour", "vuelta", "ritorno"), "back"),
    **dict.fromkeys(("backward", "backwards", "bwd", "reverse", "b", "ba", "b->a", "<"), "back"),
}

_UMLAUTS: Final = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})
_UNIT: Final = re.compile(r"(.+?)\s*[\[(]([^\[\]()]*)[\])]\s*")


def plain_text(text: str) -> str:
    """Return a text in lower case with umlauts spelt out and without accents."""
    spelt = text.strip().lower().translate(_UMLAUTS).replace("°", "")
    return "".join(sign for sign in normalize("NFKD", spelt) if not combining(sign))


def stem_and_unit(name: str) -> tuple[str, str | None]:
    """Return a column's name without its unit, plain, and the unit where it names one that calib knows.

    `name`: as found, for example ``Strecke [mm]`` or ``Weg in mm``.
    """
    in_words = re.sub(r"\s+in\s+(\S+)\s*$", r" [\1]", name.strip())
    stem, unit = split_suffix(spelled(in_words))
    if unit is None and (bracket := _UNIT.fullmatch(in_words)):
        # of a unit that is not known, or of a counter
        stem = bracket[1]
    return plain_text(re.sub(r"[.\s\-]+", "_", stem)).strip("_"), unit


def count_unit(name: str) -> str | None:
    """Return the unit of a wheel's column where its name has one in brackets: ``counts``, ``rad``, ``rad/s``."""
    bracket = _UNIT.fullmatch(name.strip())
    unit = unit_spelled(bracket[2]) if bracket else None
    return unit if unit in COUNT_UNITS else None


def _guessed(name: str, words: Sequence[tuple[str, str]], known: Sequence[str]) -> tuple[str, str | None] | None:
    exact = recognise(name, known).name
    if exact in known:
        return exact, None
    stem, unit = stem_and_unit(name)
    if known is LOG_COLUMNS:
        if corner := _AXLE_FIRST.search(_BEHIND.sub("", stem)):
            return _CORNERS[corner[1]], None
        if (short := _BEHIND.sub("", stem)) != stem and (guess := _matching(short, None, words)):
            # only wheels: pose_x_raw is none
            return guess if guess[0].startswith("counts_") else _matching(stem, unit, words)
    return _matching(stem, unit, words)


def _matching(stem: str, unit: str | None, words: Sequence[tuple[str, str]]) -> tuple[str, str | None] | None:
    for target, pattern in words:
        if re.fullmatch(pattern, stem):
            if target.startswith("load_") and unit is None and not re.search(r"las|loa|^f", stem):
                # a side alone is a wheel of any kind
                continue
            suffix = split_suffix(target)[1]
            if unit is None or target.startswith("counts_"):
                return target, None
            of_kind = suffix is not None and SUFFIXES[unit][0]
            if of_kind == suffix or (target.startswith("load_") and of_kind == "kg"):
                return target, unit
    return None


def guessed_table_column(name: str) -> tuple[str, str | None] | None:
    """Return the column of the run table that a name may mean, and its unit, or None."""
    return _guessed(name, _TABLE, TABLE_COLUMNS)


def guessed_log_column(name: str) -> tuple[str, str | None] | None:
    """Return the column of a log that a name may mean, and its unit, or None.

    `name`: as found; of a recording's ``stream:column`` or ``group/channel`` the last part counts first.
    """
    last = re.split(r"[:/]", name)[-1]
    last = re.sub(r"^(position|velocity|effort)\.", "", last)
    whole = re.sub(r"[:/.]+", "_", name).strip("_")
    return _guessed(last, _LOG, LOG_COLUMNS) or _guessed(whole, _LOG, LOG_COLUMNS)


def side_of(name: str) -> str | None:
    """Return ``left`` or ``right`` where a name says the side: ``Geber_links``, ``encoderLeft``, ``QL``."""
    split = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", re.split(r"[:/]", name)[-1])
    stem = stem_and_unit(split)[0].replace(".", "_")
    for side, pattern in _SIDES.items():
        if pattern.search(stem):
            return side
    return None
