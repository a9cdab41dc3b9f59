"""Every number that decides a word of the gap workflow: sure, possible, unknown, inconsistent.

One entry each: what it decides; what a larger value trades off; the error rate measured with it, and by what:

    blind      python -m tests.proof gap-blind --set dev --out DIR
    fresh      python -m tests.proof gap-blind --set fresh --seed 2131 --cases 66 --out DIR
    agreement  python -m tests.proof gap-agreement --family dev --cases 6 --seed 0 --out DIR

All were chosen on the development families of `blind`. The rates are those of docs/gap_blind.md; `fresh` has
other families, on which nothing was chosen.
"""

from __future__ import annotations

from inclined_landing.eval.logs.values import LEAST_RATE

# -- Which flights count -----------------------------------------------------------------------------------

FEW_FLIGHTS = 3
# decides   below: parts of a flight take the place of flights left out, and a note says so
# larger    notes on more diagnoses
# measured  fresh, three flights: 3 of 3 causes named alone, 0 of 2 sure names wrong
SHORT_FLIGHT = 20.0  # s
# decides   below, of all usable flight: a note that small effects cannot be seen
# larger    notes on more diagnoses
# measured  not measured
LAG_RATE = 0.99 * LEAST_RATE  # rows per second; 1 % for the rounding of the step
# decides   below: no lag is sure
# larger    lags of faster logs are only possible
# measured  not measured: the slowest logs of blind and fresh have 50 rows per second
LEAST_LANDINGS = 6
# decides   touchdowns from which effects of contact are named
# larger    fewer flights tell of contact; fewer wrong names
# measured  fresh, sixteen landings: 2 of 3 sure names wrong; fewer landings not measured
STRONG_WIND = 0.05  # of the weight
# decides   steady sideways force above which the attitude loops are not judged: wind turns a vehicle by
#           moments that no formula here has
# larger    loops are judged in stronger wind, and named for these moments
# measured  not measured as a rate; docs/known_causes.md has flights in a fan's wind

# -- Inconsistent flights ------------------------------------------------------------------------------------

INCONSISTENT = 0.01
# decides   familywise rate at which consistent flights are called inconsistent
# larger    more groups found, more false alarms
# measured  agreement: 0 of 6 consistent sets; found: 24 of 24 with another vehicle or a tilt of motion
#           capture, 0 of 12 with a trim of the commands
EXCITED = 0.7  # standard error over prior standard deviation
# decides   below: a flight excites an effect, which is then compared between flights
# larger    more effects compared, each with less power
# measured  not measured
DIFFERS_ALIKE = 0.05  # likelihood ratio to the best effect
# decides   above: another effect may be what differs
# larger    fewer alternatives listed
# measured  not measured
DIFFERS_BESIDE = 0.5  # share of an effect's information
# decides   above, where not confounded with the differences found: it is one more
# larger    fewer differences
# measured  not measured

# -- Named: sure or possible ---------------------------------------------------------------------------------

PRIOR_EMPTY = 0.5
# decides   prior probability that nothing is missing
# larger    fewer names, more misses
# measured  fresh, nothing hidden: no name in 8 of 8
NAMED = 0.75
# decides   probability of an effect, with those confounded with it, from which it is named
# larger    fewer spurious names, more misses
# measured  fresh, one effect hidden: alone in 18 of 23, a spurious one beside it in 1, missed in 3
SURE = 0.9
# decides   probability of a named effect from which it is sure
# larger    fewer wrong sure names, more right names only possible
# measured  fresh: 1 of 56 sure names in free flight wrong
POSSIBLE = 0.05
# decides   probability of an effect from which it is possible though not named
# larger    a shorter list, more causes missed
# measured  fresh: 44 of 45 causes among the names, sure or possible
REPORTED = 1e-3
# decides   probability of a set from which it stands in the report
# larger    shorter tables
# measured  not measured: it decides no name
CONFOUNDED = 0.03
CONFOUNDED_WITHIN = 0.95
# decides   probability from which another effect is confounded with a named one, among the sets that hold
#           CONFOUNDED_WITHIN
# larger    smaller equivalence classes, which say more and hold the cause less often
# measured  fresh: the cause another of the class named in 1 of 45
RELEVANT = 0.03  # share of the squared error of a channel
# decides   what an effect must explain to be named
# larger    more weak effects missed
# measured  fresh, weak effects: alone in 4 of 6
USEFUL = 0.1
# decides   growth of an error one second ahead, the others fitted again, without which a name is dropped
# larger    fewer names
# measured  fresh: at most two causes lost by it; public flights: 6 of 32 sure names wrong without it, 1 of 26
#           with it (docs/known_causes.md)
AT_BOUND = 1e-6  # share of a parameter's range
# decides   below: a fit is at its bound, and its effect only possible
# larger    more names only possible
# measured  not measured

# -- Unknown -------------------------------------------------------------------------------------------------

RESIDUAL = 0.02
# decides   familywise rate of the sign-flip test: a function of logged quantities predicts the residual
# larger    more causes outside the library found, more false `unknown`
# measured  fresh: 6 of 7 found; false in 1 of 8 with nothing hidden, in 0 of 3 with disturbances
MATERIAL = 0.05
# decides   share of the squared one-second error from which such a function makes the verdict `unknown`
# larger    fewer false `unknown`, more causes missed
# measured  blind: at most 0.036 where nothing, or one effect of the library, is hidden; fresh: as RESIDUAL
LANDING_RESIDUAL = 0.05
# decides   rate of the chi-squared test by which landings have a common residual
# larger    more found, more false `unknown`
# measured  fresh: false in 1 of 3 sets of landings

# -- Identifiability -----------------------------------------------------------------------------------------

UNIDENTIFIABLE = 0.7  # posterior over prior standard deviation, also of the next two
# decides   above: the flights do not excite an effect
# larger    more effects count as identified, by less
# measured  not measured
ROUGH = 0.2
# decides   above: it is poorly identified, and what is confounded with it is listed
# larger    shorter lists
# measured  not measured
UNMET = 0.95
# decides   above: identification says nothing of it, and flights that meet it name it
# larger    fewer effects left to later flights
# measured  not measured
CORRELATED = 0.8
# decides   posterior correlation above which two effects of an identified vehicle are confounded
# larger    shorter lists
# measured  not measured

# -- Planned flights -----------------------------------------------------------------------------------------

DECIDED = 0.95
# decides   probability of a set from which no flight is needed
# larger    more flights planned
# measured  not measured
LEAST_GAIN = 0.05  # nat; also of the right set's probability
# decides   expected gain from which a flight is worth flying
# larger    fewer flights, each surer to decide
# measured  not measured as a rate; docs/gap_plan.md has flights that were planned and flown
LEFT_IN_DOUBT = 0.5
# decides   share of the doubt between two sets above which a flight leaves them indistinguishable
# larger    fewer pairs called indistinguishable
# measured  not measured
