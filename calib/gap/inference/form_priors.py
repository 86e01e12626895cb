"""What is held of each form before the gap is looked at: its sizes, its sign, and how probable it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from math import comb, log
from typing import Final

import numpy as np

from calib.gap.effects.effect import Form
from calib.gap.inference.scalar_products import Layout
from calib.types import FloatArray, IntArray

#: what choosing the prior's scale by the fitted size costs, in log-evidence units
SCALE_CHOICE_COST: Final = float(np.log(4.0))


@dataclass(frozen=True, slots=True, eq=False)
class FormPriors:
    """What the weighing has to know of each form and column."""

    forms: tuple[Form, ...]  #: forms on offer
    layout: Layout  #: where the columns of each form stand
    most: FloatArray  #: shape (p,): largest prior scale of each column, in typical sizes
    sign: IntArray  #: shape (p,): 1 or -1 where only sizes of that sign have a meaning, else 0
    log_prior: FloatArray  #: shape (n_forms,): of each form of its effect, the search over forms and scales paid for
    by_count: FloatArray  #: shape (n_effects + 1,): log prior of a set of so many effects

    @staticmethod
    def from_forms(forms: Sequence[Form], further: float) -> FormPriors:
        """Make it of forms and the prior odds of one effect more at work.

        Every number of effects is less likely than one fewer by the same odds, and of so many effects every set is as
        likely: the more the library offers, the less speaks for any one, and what else is at work speaks for neither.
        Scott, Berger: Bayes and empirical-Bayes multiplicity adjustment, Annals of Statistics 38 (2010), 2587-2619.
        """
        n_effects = len({form.effect for form in forms})
        layout = Layout.of(forms)
        most, sign = np.zeros(int(layout.counts.sum())), np.zeros(int(layout.counts.sum()), dtype=np.int64)
        for number, form in enumerate(forms):
            most[layout.of_form(number)] = max([3.0, *(p.largest / p.typical for p in form.parameters)])
            sign[layout.of_form(number)] = [p.sign for p in form.parameters]
        # half of the prior lies on the sign that a parameter cannot have
        log_prior = [
            -np.log(form.tries) - SCALE_CHOICE_COST + np.log(2.0) * sum(p.sign != 0 for p in form.parameters)
            for form in forms
        ]
        return FormPriors(
            tuple(forms),
            layout,
            most,
            sign,
            np.array(log_prior),
            np.array([k * log(further) - log(comb(n_effects, k)) for k in range(n_effects + 1)]),
        )

    def index(self, models: Sequence[tuple[int, ...]]) -> tuple[IntArray, IntArray]:
        """Return the columns of each model and the form of each, both (n_models, width), -1 where there is none."""
        form, row = _forms_of(models)
        counts = self.layout.counts[form]
        at, row, owner = (np.repeat(each, counts) for each in (self.layout.starts[form], row, form))
        # number of each column within its form, and within its model
        at += _within(np.repeat(np.arange(len(form)), counts))
        place = _within(row)
        table = np.full((2, len(models), int(place.max(initial=-1)) + 1), -1)
        table[:, row, place] = at, owner
        return table[0], table[1]

    def widths(self, models: Sequence[tuple[int, ...]]) -> IntArray:
        """Return the number of columns of each model, shape (n_models,)."""
        form, row = _forms_of(models)
        return np.bincount(row, self.layout.counts[form], len(models)).astype(np.int64)

    def priors(self, models: Sequence[tuple[int, ...]]) -> FloatArray:
        """Return the log prior of each model, shape (n_models,)."""
        form, row = _forms_of(models)
        return np.bincount(row, self.log_prior[form], len(models)) + self.by_count[[len(model) for model in models]]


def _forms_of(models: Sequence[tuple[int, ...]]) -> tuple[IntArray, IntArray]:
    """Return the forms of all models end to end, and the number of the model of each."""
    form = np.fromiter(chain.from_iterable(models), dtype=np.int64)
    return form, np.repeat(np.arange(len(models)), [len(model) for model in models])


def _within(row: IntArray) -> IntArray:
    """Return the number of each place among those of its row; rows ascend."""
    return np.arange(len(row)) - np.searchsorted(row, row)
