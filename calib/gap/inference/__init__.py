"""The numbers on which a verdict and a fix rest, each with its reason, and the limits that follow from them."""

from math import log
from typing import Final

#: chance that a true cause fails a test: as of every stated interval and set
FALSE_REJECTION: Final = 0.05
CONFIDENCE: Final = 1.0 - FALSE_REJECTION
#: more likely than not
EVEN_PROBABILITY: Final = 0.5
#: as much is explained as remains: where certainly less, causes imitate the unexplained one (in 8 of 8 opened sets, 2
#: of 3 altered recordings)
HALF_CLOSURE: Final = 0.5

#: least probability of a reported gap: an all-clear beside a gap costs 2.3 times a false alarm
REPORTED_GAP_PROBABILITY: Final = 0.3

#: least probability of a named cause, with all that it is confounded with
NAMED_PROBABILITY: Final = 0.1
#: log evidence within which hypotheses are not separated: the same odds
LOG_EVIDENCE_WINDOW: Final = -log(NAMED_PROBABILITY)
#: least own probability of a small cause, or one beside a residual that hides whether a correction helps: of small ones
#: at 0.8 to 0.9 in 350 development cases 4 of 7 were not at work
CERTAIN_PROBABILITY: Final = 1.0 - NAMED_PROBABILITY

#: least probability that all causes of a fix are at work: a wrong one costs 1.5 times one withheld
FIX_PROBABILITY: Final = 0.6
#: and of a cause beside the largest: of 17 fixes whose causes all had 0.6 to 0.8 in 1,792 cases 8 were wrong, none of
#: the 10 with one cause
FURTHER_PROBABILITY: Final = 0.8
#: causes are ordered by these classes of probability, then by signal: finer differences are chance
PROBABILITY_CLASSES: Final = (REPORTED_GAP_PROBABILITY, FIX_PROBABILITY, FURTHER_PROBABILITY)

#: least closure of a believed explanation: over two thirds of the error's square go
ADEQUATE_CLOSURE: Final = 0.7
#: closure below which an unexplained residual hides whether anything is explained
HIDDEN_CLOSURE: Final = 1.0 - ADEQUATE_CLOSURE

#: share of the gap's squares that is small: an unexplained residual of more is part of the verdict
SMALL_SHARE: Final = 0.05
#: least closure of an explained gap
FULL_CLOSURE: Final = 1.0 - SMALL_SHARE
#: share of noise's squares below which growth harms nobody: 2.5 % of its root mean square
NEGLIGIBLE_GROWTH: Final = SMALL_SHARE
#: error of a law's form, as a share of its size; also what one size may differ by between groups of runs
FORM_ERROR: Final = SMALL_SHARE

#: what is no noise in a channel: of its square three quarters. Also how much stronger a fix's cause is than an
#: unexplained residual, half of which a weaker one may be
NOISE_LEVELS: Final = 2.0

#: chance that noise alone exceeds its limit in any trial of a campaign: a verdict rests on a hundred
FALSE_ALARM: Final = 0.01
