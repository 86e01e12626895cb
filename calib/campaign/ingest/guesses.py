"""What columns may mean: by their names in English, German, French, Italian, Spanish; by what their numbers do."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final
from unicodedata import combining, normalize

import numpy as np

from calib.campaign.ingest.mapping import TABLE_COLUMNS, units_for
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.readers.sheets import COUNT_UNITS, unit_spelled
from calib.campaign.settings import recognise, spelled
from calib.types import FloatArray
from calib.units import split_suffix

_COUNTS: Final = (
    r"(impuls|count|enc|geber|tick|inkrement|increment|zaehl|pulse|wheel|rad_|joint|drehgeber|quad|q|odo|motor|raw"
    r"|codeu?r|codificador|compteur|contador|contatore|roue|rueda|ruota)"
)
#: sides of a vehicle, short and long
_LEFT: Final = r"(l|li|links|left|gauche|izq|izquierd[ao]|sx|sinistr[ao])"
_RIGHT: Final = r"(r|re|rechts|right|droite?|der|derech[ao]|dx|destr[ao])"
#: what a force on a wheel is called, and what stands between it and the side
_FORCE: Final = r"(last|load|force|effort|charge|poids|fuerza|carga|forza|carico|kraft|f)"
_ON_WHEEL: Final = r"((normal|vertical|on|at|the|de|sur|en|la|sulla|della|sul)e?_)*((rad|wheel|roue|rueda|ruota)_)?"
_PLACE: Final = r"(hallen|hall|boden|floor|luft|air|raum|room|ambient|umgebungs?|aussen|reifen|tyre|tire)"

#: column of the run table -> what its name may look like, letters lower and umlauts spelt out
_TABLE: Final[Mapping[str, str]] = {
    "run_id": (
        r"(run|lauf|fahrt|messung|messfahrt|versuch|trial|test|drive)(_?(id|no|nr|nummer|number|name|#))?\.?|nr\.?|id|#"
        r"|(lfd|lauf)_nr|((n|no|num|numero)_)?(essai|mesure|passage|ensayo|prueba|corsa|prova|misura)|num|numero"
    ),
    "session": (
        r"(sitzung|session|schicht|serie|messtag|tag|day)(_?(id|nr|no))?|datum|date|messdatum"
        r"|jour|seance|fecha|sesion|data|giorno"
    ),
    "direction": r".*(richtung|direction|heading_of_run)|way|dir|sens|sentido|direccion|senso|verso|direzione",
    "kind": r"(art|route|kurs|course|kind|type|typ|streckenart|manoever|path)",
    "load_left_N": (
        r"(rad|wheel|waage|scale)?_?(last|load)?_?(links|left)|((rad|wheel)_?)?(last|load)_?(li|l)|f_?(left|l)"
        rf"|{_FORCE}_{_ON_WHEEL}({_LEFT}|g)|{_LEFT}_{_ON_WHEEL}{_FORCE}"
    ),
    "load_right_N": (
        r"(rad|wheel|waage|scale)?_?(last|load)?_?(rechts|right)|((rad|wheel)_?)?(last|load)_?(re|r)|f_?(right|r)"
        rf"|{_FORCE}_{_ON_WHEEL}({_RIGHT}|d)|{_RIGHT}_{_ON_WHEEL}{_FORCE}"
    ),
    "payload_x_m": (
        r"(payload|last|zuladung|ladung|nutzlast)_?(x|vorn.*|laengs)|(abstand|lage)_?(vorn.*|x|laengs)|x_(of_)?(the_)?(payload|load)"
        r"|(pos(ition|icion|izione)?_)?((of|the|de|la|del)_)*(payload|load|charge|carga|carico)_(utile?_)?x"
    ),
    "payload_y_m": (
        r"(payload|last|zuladung|ladung|nutzlast)_?(y|quer)|(versatz|quer|lage_?y).*|y_(of_)?(the_)?(payload|load)"
        r"|(pos(ition|icion|izione)?_)?((of|the|de|la|del)_)*(payload|load|charge|carga|carico)_(utile?_)?y"
    ),
    "payload_kg": (
        r"(zuladung|nutzlast|beladung|ladung|payload|masse|mass|gewicht|weight|load|last|massa)"
        r"|(charge|carga|carico)(_(utile|util))?"
        r"|(mass|masse|gewicht|weight|load|masa|massa)_(on|auf|in|sur|en|su)_.*"
        r"|(mass|masse|gewicht|weight)_(of_)?(the_)?(zuladung|nutzlast|ladung|payload|load|last)"
        r"|(zuladung|nutzlast|ladung|payload|load|last)s?_?(masse|mass|gewicht|weight)"
    ),
    "speed_mps": r"((soll|set|mean)_?)?(geschw.*|speed.*|velocity|tempo|v_?soll|v|vitesse.*|velocidad.*|velocita.*)",
    "temperature_C": rf"({_PLACE}_?)?temp(eratur[ea]?)?(_.*)?",
    "minutes_under_load": r"(standzeit|minutes?_under_load|dwell.*)",
    "distance_m": (
        r"((laser|mess|fahr|gemessene|measured|travelled|true|ref|reference|wahre)_?)?(strecke|distanz|distance|dist|weg|laenge|length|s_?o|longueur|trajet|distancia|recorrido|distanza|percorso)"
        r"(_.*)?|travel(led)?"
    ),
    "counts_left": rf"{_COUNTS}.*(_?{_LEFT}|_g)",
    "counts_right": rf"{_COUNTS}.*(_?{_RIGHT}|_d)",
    "ref_x_m": r"(ref|mocap|tracker|end|ziel|final)_?x",
    "ref_y_m": r"(ref|mocap|tracker|end|ziel|final)_?y",
    "ref_theta_rad": (
        r"(ref|mocap|tracker|end|ziel|final)_?(theta|yaw|heading|winkel|kurs|kurswinkel)|theta|yaw|heading|kurswinkel"
    ),
    "excluded": r"(excluded|ungueltig|ausschluss|ausgeschlossen)",
}
#: what measures poses from outside, and what a speed is called
_TRACKER: Final = r"(ref|mocap|pose|pos|tracker|vicon|optitrack|qualisys|motive)"
_SPEED: Final = r"(vel|velocity|speed|geschwindigkeit)"
_LOG: Final[Mapping[str, str]] = {
    "t_s": (
        r"(t|time|zeit|timestamp|zeitstempel|stamp|uhrzeit|datum_?zeit|epoch|unix(_?time)?|horodatage|temps|tiempo|tempo)(_.*)?"
    ),
    "counts_front_left": r".*(front_?(l|left)|v_?l|vorn.*links)",
    "counts_front_right": r".*(front_?(r|right)|v_?r|vorn.*rechts)",
    "counts_rear_left": r".*((rear|back)_?(l|left)|h_?l|hinten.*links)",
    "counts_rear_right": r".*((rear|back)_?(r|right)|h_?r|hinten.*rechts)",
    "counts_front": _COUNTS + r".*_?(front|vorn|vorne|v)",
    "counts_left": rf"({_COUNTS}.*_?)?{_LEFT}|{_COUNTS}.*_g",
    "counts_right": rf"({_COUNTS}.*_?)?{_RIGHT}|{_COUNTS}.*_d",
    "steer_rad": r".*(steer|lenk|braquage|sterzo).*",
    "speed_rear_mps": rf"{_SPEED}_?(encoder|enc|rear|shaft|drive|antrieb)|(encoder|rear|shaft|drive)_?{_SPEED}",
    "range_m": r".*(laser|range|abstand|entfernung|distan[cz]|weg|strecke|telemetr[eo]).*",
    "ref_x_m": rf"({_TRACKER}_?)?x(_?true)?",
    "ref_y_m": rf"({_TRACKER}_?)?y",
    "gyro_z_radps": r".*(angular_velocity_?z|gyro(_?z)?|yaw_?rate|gierrate|drehrate)",
    "ref_theta_rad": rf"({_TRACKER}_?)?(theta|yaw|heading|gier.*)",
}
#: what stands behind the side in the name of a wheel: left_wheel_joint, wheel_left_joint, Enc_L_raw
_BEHIND: Final = re.compile(
    r"(_(joint|wheel|motor|axle|axis|pos|position|encoder|enc|counts?|cnt|ticks?|data|raw|geber|rad|drive|shaft|total))+$"
)
#: first letters of a robot's wheels: fl, rear_right_drive; 'rear' of two wheels is no axle of its own
_AXLE_FIRST: Final = re.compile(r"(?:^|_)(fl|fr|rl|rr|bl|br)$")
_AXLES: Final = {"f": "front", "r": "rear", "b": "rear"}
_SIDES: Final = {
    "left": re.compile(r"(?:^|_)(l|li|left|links|linkes|linker|lhs|g|gauche|izq|izquierd[ao]|sx|sinistr[ao])(?=_|$)"),
    "right": re.compile(r"(?:^|_)(r|re|right|rechts|rechtes|rechter|rhs|d|droite?|der|derech[ao]|dx|destr[ao])(?=_|$)"),
}

#: directions along a corridor, in words: plain, or as `plain_text` gives them
_DIRECTIONS: Final = (
    ("out", r"out|hin(fahrt|weg)?|vor(waerts)?|forward|fwd|there|forth|outbound|a|ab|a->b|aller|ida|andata|>|\+"),
    ("back", r"backward(s)?|bwd|back|(zu)?rueck(waerts|fahrt|weg)?|her|ret(urn|our)?|inbound|vuelta|ritorno|reverse"),
    ("back", r"b|ba|b->a|<"),
)

_UMLAUTS: Final = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})
_UNIT: Final = re.compile(r"(.+?)\s*[\[(]([^\[\]()]*)[\])]\s*")


def plain_text(text: str) -> str:
    """Return a text in lower case with umlauts spelt out and without accents."""
    spelt = text.strip().lower().translate(_UMLAUTS).replace("°", "")
    return "".join(sign for sign in normalize("NFKD", spelt) if not combining(sign))


def direction_of(text: str) -> str | None:
    """Return ``out`` or ``back`` where a text names a direction along a corridor."""
    return next((way for way, pattern in _DIRECTIONS if re.fullmatch(pattern, plain_text(text))), None)


def stem_and_unit(name: str) -> tuple[str, str | None]:
    """Return a column's name without its unit, plain, and the unit where it names one that calib knows.

    `name`: as found, for example ``Strecke [mm]`` or ``Weg in mm``.
    """
    in_words = re.sub(r"\s+in\s+(\S+)\s*$", r" [\1]", name.strip())
    stem, unit = split_suffix(spelled(in_words))
    if unit is None and (bracket := _UNIT.fullmatch(in_words)):
        # a side, a unit that is not known, or one of a counter
        is_side = re.fullmatch(rf"{_LEFT}|{_RIGHT}", plain_text(bracket[2]))
        stem = f"{bracket[1]}_{bracket[2]}" if is_side else bracket[1]
    return plain_text(re.sub(r"[.\s\-]+", "_", stem)).strip("_"), unit


def count_unit(name: str) -> str | None:
    """Return the unit of a wheel's column where its name has one in brackets: ``counts``, ``rad``, ``rad/s``."""
    bracket = _UNIT.fullmatch(name.strip())
    unit = unit_spelled(bracket[2]) if bracket else None
    return unit if unit in COUNT_UNITS else None


def guessed_table_column(name: str) -> str | None:
    """Return the column of the run table that a name may mean, or None."""
    exact = recognise(name, TABLE_COLUMNS).name
    return exact if exact in TABLE_COLUMNS else _matching(*stem_and_unit(name), _TABLE)


def guessed_log_column(name: str) -> str | None:
    """Return the column of a log that a name may mean, or None.

    `name`: as found; of a recording's ``stream:column`` or ``group/channel`` the last part counts first.
    """
    last = re.sub(r"^(position|velocity|effort)\.", "", re.split(r"[:/]", name)[-1])
    whole = re.sub(r"[:/.]+", "_", name).strip("_")
    return _guessed_in_log(last) or _guessed_in_log(whole)


def _guessed_in_log(name: str) -> str | None:
    exact = recognise(name, LOG_COLUMNS).name
    if exact in LOG_COLUMNS:
        return exact
    stem, unit = stem_and_unit(name)
    short = _BEHIND.sub("", stem)
    if corner := _AXLE_FIRST.search(short):
        return f"counts_{_AXLES[corner[1][0]]}_{'left' if corner[1][1] == 'l' else 'right'}"
    wheel = _matching(short, None, _LOG) if short != stem else None
    # only wheels: pose_x_raw is none
    return wheel if wheel and wheel.startswith("counts_") else _matching(stem, unit, _LOG)


def _matching(stem: str, unit: str | None, words: Mapping[str, str]) -> str | None:
    for target, pattern in words.items():
        if not re.fullmatch(pattern, stem):
            continue
        if target.startswith("load_") and unit is None and not re.search(rf"las|loa|^f|(^|_){_FORCE}(_|$)", stem):
            # a side alone is a wheel of any kind
            continue
        if unit is None or target.startswith("counts_") or unit in units_for(target):
            return target
    return None


def side_of(name: str) -> str | None:
    """Return ``left`` or ``right`` where a name says the side: ``Geber_links``, ``encoderLeft``, ``QL``."""
    for part in (re.split(r"[:/]", name)[-1], re.sub(r"[:/]", "_", name)):
        stem = stem_and_unit(re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", part))[0].replace(".", "_")
        if side := next((side for side, pattern in _SIDES.items() if pattern.search(stem)), None):
            return side
    return None


def rises_evenly(values: FloatArray) -> bool:
    """Return whether values of shape (n_rows,) rise in even steps, as a clock does."""
    steps = np.diff(values)
    usual = float(np.median(steps)) if len(steps) > 1 else 0.0
    return usual > 0 and bool((steps >= 0).all() and np.mean(np.abs(steps - usual) < _EVEN * usual) > _MOSTLY)


def usual_step(values: FloatArray) -> float:
    """Return the median step between rows, of the steps other than 0."""
    steps = np.abs(np.diff(values))
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


#: share of all steps that a column rises by in the end, where it rises without a break
_RISES: Final = 0.98
#: shares of a turn: a jump back of an angle, and its span with rounding
_JUMP, _ONE_TURN = 0.75, 1.001
#: how far a clock's step is from the usual one, as a share of it, and the share of steps that are so
_EVEN, _MOSTLY = 0.05, 0.9
#: least correlation of a counter's steps with the next: a smooth drive has nearly 1, noise on a speed -0.5
_ALIKE: Final = 0.2
#: what a plain counter does, and an angle without end
RISES: Final = "rises without a break"
#: turn at which an angle starts again -> what it does then
_TURNS: Final = {2 * np.pi: "an angle that starts again after 2 pi", 360.0: "an angle that starts again after 360"}
#: what the numbers of a wheel do -> the unit that they are in then
BEHAVIOURS: Final = {
    "increments, a count a sample": "counts/sample",
    _TURNS[2 * np.pi]: "rad",
    _TURNS[360.0]: "deg",
    RISES: "",
}


def behaviour(values: FloatArray, *, whole: bool) -> str:
    """Return what a column's numbers do, of `BEHAVIOURS`; empty where they do nothing that a wheel does.

    `values` (shape (n_rows,)): finite; `whole`: whether all are integers.
    """
    steps, span = np.diff(values), float(np.ptp(values))
    total = float(np.abs(steps).sum())
    if not span:
        return ""
    if abs(values[-1] - values[0]) > _RISES * total:
        return RISES
    for turn, words in _TURNS.items():
        jumps = np.abs(steps) > _JUMP * turn
        steady = np.abs(steps[~jumps]).max(initial=0.0) < 0.5 * turn
        if _JUMP * turn < span <= _ONE_TURN * turn and jumps.any() and steady:
            return words
    # what moves goes on: the steps of a counter are alike from one to the next, those of increments are not
    alike = float(np.sum(steps[1:] * steps[:-1])) / float(np.sum(steps * steps))
    return "increments, a count a sample" if whole and alike < _ALIKE else ""
