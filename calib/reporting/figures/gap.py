"""Figures of a gap, of an effect's signature, and of what a plan tells apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.effects.library import UNCHANGED, EffectSignature
from calib.gap.observations import Channel
from calib.gap.plan import Outlook
from calib.gap.predict import Path
from calib.radius import Groups
from calib.reporting import figures as style
from calib.reporting.figures import GREY, INK, colour, group_legend, legible, panels, round_down, styled
from calib.reporting.formatting import readable, with_unit
from calib.types import FloatArray, StrArray

#: over the floor plan's larger side
ARROW_SHARE: Final = 0.12
#: half a page
MAP_HEIGHT_CM: Final = 11.5
#: of one channel: two rows of three
MAX_PANELS: Final = 6
#: correlation of covariates that make one picture
ALIKE: Final = 0.98


@dataclass(frozen=True, slots=True, eq=False)
class GapArrays:
    """Arrays of a diagnosis for its figures and panels."""

    #: name and unit (``m`` or ``rad``) of each channel, shape (n_channels,)
    channels: tuple[tuple[str, str], ...]
    #: run, session and kind of each observation, shape (n,)
    labels: Mapping[str, StrArray]
    #: measured minus simulated without and with the named causes, held out, and one standard deviation; NaN without the
    #: channel, (n, n_channels)
    before: FloatArray
    after: FloatArray
    noise_level: FloatArray
    covariates: Mapping[str, FloatArray]  #: by name with unit suffix, shape (n,)
    #: predicted path of each observation from its start, shape (n_samples, 2); empty without end positions
    paths_m: tuple[FloatArray, ...] = ()
    offset_m: FloatArray | None = None  #: measured minus predicted end position in that frame, shape (n, 2)

    @staticmethod
    def of(diagnosis: Diagnosis) -> "GapArrays":
        """Return the arrays of a diagnosis."""
        from calib.gap.localise.locate import covariate_values
        from calib.gap.predict import measured_gap

        observations, nominal, held_out = diagnosis.observations, diagnosis.nominal, diagnosis.arrays.held_out
        usable = observations.usable
        _, along, lateral, *_ = np.where(usable, measured_gap(nominal, nominal), np.nan).T
        c, sn = np.cos(nominal.frame), np.sin(nominal.frame)
        offset = np.column_stack((c * along - sn * lateral, sn * along + c * lateral))
        known, columns = bool(np.isfinite(offset).any()), covariate_values(observations).items()
        ends = [None if posed or not observations.windowed else 1 for posed in usable[:, Channel.ALONG]]
        before, after, noise_level = (
            np.where(usable, part, np.nan) for part in (held_out.before, held_out.after, held_out.floor)
        )
        return GapArrays(
            channels=tuple((channel.label, channel.unit) for channel in Channel),
            labels={name: observations.labels[name] for name in ("run_id", "session", "kind")},
            before=before,
            after=after,
            noise_level=noise_level,
            covariates={name: column.astype(np.float64) for name, column in columns if column.dtype.kind == "f"},
            paths_m=tuple(t[:end, :2] for t, end in zip(nominal.traces(), ends, strict=True)) if known else (),
            offset_m=offset if known else None,
        )


@styled
def gap_map(paths_m: Sequence[FloatArray], offset_m: FloatArray, group: StrArray) -> Figure:
    """Draw every run's path, its gap as an arrow from simulated to measured end; `group` (n,): kind, for colours."""
    ends, points = np.array([path[-1] for path in paths_m]), np.concatenate(list(paths_m))
    known = np.asarray(np.isfinite(np.hstack((offset_m, ends))).all(axis=1))
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(max(np.max(high - low), 1e-3))
    length = np.hypot(*offset_m[known].T)
    typical = float(np.quantile(length, 0.9)) if len(length) else 0.0
    factor = round_down(ARROW_SHARE * size / typical) if typical > 0 else 1.0
    tips = np.add(ends, factor * np.where(known.reshape(-1, 1), offset_m, 0.0))
    low, high = np.minimum(low, tips.min(axis=0)), np.maximum(high, tips.max(axis=0))
    margin = 0.04 * float(max(np.max(high - low), 1e-3))
    aspect = float((high[1] - low[1] + 2 * margin) / (high[0] - low[0] + 2 * margin))
    stretched = aspect < 0.12
    figure = style.canvas(float(np.clip(2.6 + 0.86 * style.WIDTH_CM * aspect, 6.0, MAP_HEIGHT_CM)))
    axis = figure.add_subplot()
    groups = _groups(group)
    for path in paths_m:
        axis.plot(path[:, 0], path[:, 1], color="#C4C9CE", lw=0.7, solid_capstyle="round")
    x, y = np.where(known[:, None], ends, np.nan).T
    style.draw_groups(axis, groups, x, y, marker="o", ms=2.2)
    arrow = {"arrowstyle": "-|>", "lw": 0.9, "mutation_scale": 6, "shrinkA": 0, "shrinkB": 0}
    for k in np.flatnonzero(known):
        tint = colour(int(groups.index[k]))
        axis.annotate("", xy=tuple(tips[k]), xytext=tuple(ends[k]), arrowprops={**arrow, "color": tint})
    axis.set_xlim(low[0] - margin, high[0] + margin)
    axis.set_ylim(low[1] - margin, high[1] + margin)
    if not stretched:
        axis.set_aspect("equal", adjustable="box")
    axis.set(xlabel="x (m)", ylabel="y (m)")
    scale = ""
    if len(length):
        unit_factor, unit = readable("m", float(length.max()))
        scale = f"largest {unit_factor * float(length.max()):.3g} {unit}; "
    magnified = "to scale" if factor == 1 else f"{factor:g} times"
    note = ", y stretched" if stretched else ""
    axis.set_title(f"Gap at the end of each run ({scale}arrows {magnified}{note})")
    group_legend(figure, axis, groups.names, below=True)
    return figure


@styled
def gap_by_covariate(
    residual: FloatArray,
    channel: str,
    unit: str,
    covariates: Mapping[str, FloatArray],
    *,
    noise_level: float,
    group: StrArray,
) -> Figure:
    """Draw one channel's gap against each covariate, with class means and their 95 % intervals.

    `group` (n,): kind of each run, for colours; see `GapArrays`.
    """
    shown = [(name, covariates[name]) for name in distinct(covariates)][:MAX_PANELS]
    factor, name = readable(unit, _largest(residual))
    figure, axes = panels(len(shown), 1.6, 4.4, sharey=True)
    groups = _groups(group)
    gap = factor * residual
    for axis, (title, values) in zip(axes.flat, shown, strict=False):
        good = np.isfinite(gap) & np.isfinite(values)
        axis.axhspan(-factor * noise_level, factor * noise_level, color=GREY, alpha=0.3, lw=0.5, ec=INK)
        axis.axhline(0.0, color=GREY, lw=0.6)
        style.draw_groups(axis, groups, values, gap, marker="o", ms=2.2, alpha=0.6, mew=0)
        if good.sum() >= 3:
            centre, mean, error = _classes(values[good], gap[good])
            axis.errorbar(centre, mean, yerr=error, fmt="s", color=INK, elinewidth=0.8, ms=2.6)
        axis.set_xlabel(legible(with_unit(title)))
        axis.margins(x=0.06, y=0.08)
        axis.locator_params(axis="x", nbins=4)
    known = gap[np.isfinite(gap)]
    if len(known):
        low, high = min(float(known.min()), 0.0), max(float(known.max()), 0.0)
        margin = 0.08 * max(high - low, factor * noise_level)
        axes[0, 0].set_ylim(low - margin, high + margin)
    for row in axes:
        row[0].set_ylabel(f"{channel} ({name})")
    group_legend(figure, axes[0, 0], groups.names)
    return figure


@styled
def before_after(
    channels: Sequence[tuple[str, str]], before: FloatArray, after: FloatArray, noise_level: FloatArray
) -> Figure:
    """Draw the runs' gap before and after the fix, channel by channel, with mean and noise level; see `GapArrays`."""
    used = [k for k in range(len(channels)) if np.isfinite(before[:, k]).any()]
    figure, axes = panels(len(used), 1.2, 4.8)
    for axis, k in zip(axes.flat, used, strict=False):
        title, unit = channels[k]
        factor, name = readable(unit, _largest(before[:, k]))
        level = factor * rms(noise_level[:, k])
        if np.isfinite(level):
            axis.axhspan(-level, level, color=GREY, alpha=0.22, lw=0)
        axis.axhline(0.0, color=GREY, lw=0.6)
        for place, (values, tint) in enumerate(((before[:, k], style.ORANGE), (after[:, k], style.BLUE))):
            gaps = factor * values[np.isfinite(values)]
            aside = 0.26 * (2 * ((np.arange(len(gaps)) * 0.6180339887498949) % 1.0) - 1)
            axis.plot(
                place + aside, gaps, "o", ms=2.2, mew=0, color=tint, alpha=0.55, rasterized=len(gaps) > style.MANY
            )
            mean, spread = (float(gaps.mean()), float(gaps.std())) if len(gaps) else (np.nan, np.nan)
            axis.errorbar(place, mean, yerr=spread, color=tint, elinewidth=1.4, capsize=9, capthick=1.4)
            axis.plot([place - 0.3, place + 0.3], [mean, mean], color=tint, lw=2.2)
        sizes = [f"{factor * rms(values[:, k]):.3g} {name}" for values in (before, after)]
        axis.set_xticks([0, 1], [f"before\nrms {sizes[0]}", f"after\nrms {sizes[1]}"])
        axis.set_xlim(-0.5, 1.5)
        axis.grid(visible=False, axis="x")
        noise = f", noise {level:.3g} {name}" if np.isfinite(level) else ""
        axis.set(title=f"{title}{noise}", ylabel=f"gap ({name})")
        axis.margins(y=0.08)
    return figure


def gap_figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Return the figures of a diagnosis by name; figures without data are omitted."""
    gap = GapArrays.of(diagnosis)
    figures: dict[str, Figure] = {}
    if gap.offset_m is not None:
        figures["gap-map"] = gap_map(gap.paths_m, gap.offset_m, gap.labels["kind"])
    lines = diagnosis.where.covariates
    for k, (channel, unit) in enumerate(gap.channels):
        # covariates of the verdict first, those of this channel before others
        ranked = [line.name for line in lines if line.channel_label == channel] + [line.name for line in lines]
        names = [name for name in dict.fromkeys([*ranked, *gap.covariates]) if name in gap.covariates]
        if names and np.isfinite(gap.before[:, k]).any():
            figures[f"gap-by-covariate-{channel}"] = gap_by_covariate(
                gap.before[:, k], channel, unit, {name: gap.covariates[name] for name in names},
                noise_level=rms(gap.noise_level[:, k]), group=gap.labels["kind"],
            )  # fmt: skip
    figures["before-after"] = before_after(gap.channels, gap.before, gap.after, gap.noise_level)
    return figures


def distinct(covariates: Mapping[str, FloatArray]) -> dict[str, list[str]]:
    """Return the covariates worth a panel each, with later ones that would look alike."""
    kept: dict[str, list[str]] = {}
    for name, values in covariates.items():
        like = next((other for other in kept if _alike(values, covariates[other])), None)
        if like is None:
            kept[name] = []
        else:
            kept[like].append(name)
    return kept


def _alike(one: FloatArray, other: FloatArray) -> bool:
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < 3 or np.ptp(one[both]) == 0 or np.ptp(other[both]) == 0:
        return False
    return bool(abs(np.corrcoef(one[both], other[both])[0, 1]) > ALIKE)


def _largest(values: FloatArray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if len(known) else 0.0


def rms(values: FloatArray) -> float:
    """Return the root mean square of the finite values; NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def _groups(group: StrArray) -> Groups:
    longest = max(int(np.char.str_len(group).max()), 1)
    return style.named_groups(np.char.replace(group, "_", " "), "(none)", limit=longest)


def _classes(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    from calib.gap.decision.constancy import half_of_mean

    values, index = np.unique(x, return_inverse=True)
    if len(values) > 8:
        index = np.searchsorted(np.quantile(x, np.linspace(0, 1, 9)[1:-1]), x, side="right")
    classes = [(x[index == k], y[index == k]) for k in np.unique(index)]
    rows = [(at.mean(), sizes.mean(), half_of_mean(sizes) if len(sizes) > 1 else 0.0) for at, sizes in classes]
    centre, mean, error = np.array(rows).T
    return centre, mean, error


@styled
def signature_figure(signature: EffectSignature, nominal: Path) -> Figure:
    """Draw a signature beside the model alone on the same runs (`nominal`).

    Left a run of each kind without the effect, grey, and with it, enlarged; right the change of each channel.
    """
    kinds = nominal.s.labels["kind"]
    names = list(np.unique(kinds))
    moved = np.flatnonzero(np.abs(np.nan_to_num(signature.change)).max(axis=0) > UNCHANGED).tolist()
    figure = style.canvas(6.4)
    plan, channels = figure.subfigures(1, 2, width_ratios=(1.0, 1.25), squeeze=False)[0]
    _draw_plan(plan.subplots(), signature, nominal, names)
    panels = channels.subplots(max(len(moved), 1), 1, sharex=True, squeeze=False)[:, 0]
    for axes, channel in zip(panels, moved, strict=False):
        _draw_channel(axes, signature.change[:, channel], Channel(channel), kinds, names)
    panels[0].set_title("change at its typical size, channels that move")
    panels[-1].set_xticks(range(len(names)), names, rotation=20, ha="right")
    return figure


def _draw_plan(axes: Axes, signature: EffectSignature, nominal: Path, names: list[str]) -> None:
    s, enlarged = nominal.s, signature.enlarged
    for number, name in enumerate(names):
        units = np.flatnonzero(s.labels["kind"] == name)
        unit = int(units[np.argmax(np.nansum(signature.change[units] ** 2, axis=1))])
        part, tint = slice(int(s.starts[unit]), int(s.starts[unit + 1])), colour(number)
        axes.plot(nominal.steps.x_m[part], nominal.steps.y_m[part], color=GREY, linewidth=0.8)
        axes.plot(enlarged.steps.x_m[part], enlarged.steps.y_m[part], color=tint, linewidth=1.1, label=name)
        axes.plot(*enlarged.end[unit, :2], marker="o", markersize=3, color=tint)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x (m)", ylabel="y (m)")
    bent = signature.factor > 1.0 and bool(np.ptp(enlarged.end[:, :2] - nominal.end[:, :2]) > 0)
    axes.set_title(f"paths, effect x {signature.factor:.3g}" if bent else "paths (the effect bends none)")


def _draw_channel(axes: Axes, change: FloatArray, channel: Channel, kinds: StrArray, names: list[str]) -> None:
    for number, kind in enumerate(names):
        values = 1e3 * change[kinds == kind]
        axes.plot(number + np.linspace(-0.25, 0.25, len(values)), values, ".", markersize=2.5, color=colour(number))
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.margins(y=0.2)
    axes.set_ylabel(f"{channel.label}\nm{channel.unit}", rotation=0, ha="right", va="center")
    axes.set_xlim(-0.5, len(names) - 0.5)


#: classes' bounds in standard deviations; two effects below 3 cannot be told apart
BOUNDS: Final = (0.0, 1.0, 3.0, 5.0, 10.0, 1e12)
SHADES: Final = ("#B2482C", "#E39A72", "#F1E3C8", "#8FBBD3", "#2F78A8")


@styled
def plan_matrix(outlook: Outlook) -> Figure:
    """Draw the matrix: row, the effect at work; column, the effect that might be named instead."""
    n = len(outlook.effects)
    figure = style.canvas(float(np.clip(5.0 + 0.36 * n, 8.0, 21.0)))
    axis = figure.add_subplot()
    distance = np.column_stack((outlook.signal, np.where(np.isfinite(outlook.distance), outlook.distance, np.nan)))
    shown = np.ma.masked_invalid(distance)
    colours = ListedColormap(list(SHADES)).with_extremes(bad="white")
    image = axis.imshow(shown, cmap=colours, norm=BoundaryNorm(list(BOUNDS), colours.N), aspect="auto")
    names = [name.replace("_", " ") for name in outlook.effects]
    axis.set_xticks(range(n + 1), ["(detected)", *names], rotation=90)
    apart = outlook.told_apart
    rows = [f"{name}  {'told apart' if yes else '–'}" for name, yes in zip(names, apart, strict=True)]
    axis.set_yticks(range(n), rows)
    axis.tick_params(length=0, labelsize=5.5)
    axis.set_xticks(np.arange(-0.5, n + 1), minor=True)
    axis.set_yticks(np.arange(-0.5, n), minor=True)
    axis.grid(visible=False, which="major")
    axis.grid(which="minor", color="white", lw=0.5)
    axis.tick_params(which="minor", length=0)
    axis.axvline(0.5, color=INK, lw=0.8)
    axis.set_title(f"{int(apart.sum())} of {n + len(outlook.absent)} effects can be told apart at their typical size")
    axis.set_ylabel("effect at work")
    axis.set_xlabel("effect that might be named instead")
    bar = figure.colorbar(image, ax=axis, spacing="uniform", shrink=0.5, pad=0.01)
    bar.set_ticks([0.5, 2.0, 4.0, 7.5, 5e11], labels=["below 1", "1 to 3", "3 to 5", "5 to 10", "above 10"])
    bar.ax.tick_params(which="both", length=0)
    bar.set_label("distance (standard deviations)")
    return figure
