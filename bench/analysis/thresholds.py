"""Every number above or below which analysis decides otherwise: what a calibration, a fit or a verdict must keep to.

Tuning of an algorithm (grid points, blocks, tolerances of a search) stands beside the algorithm.
"""

from __future__ import annotations

from bench.record import STILL_DEGC_PER_MIN

# Which rows count as standing still
SETTLED_DEGC_PER_MIN = 2 * STILL_DEGC_PER_MIN
"""Slope below which the temperature stands still, seen over the noise of a slope."""
TURNING_DPS = 0.1
"""Rate above which a rate table turns: the scale factor is then part of the output."""

# What a fit needs
LEAST_RANGE_DEGC = 1.0
"""A temperature that moves by less carries no temperature effect."""
LEAST_RATES = 3
"""Rates, rest among them, that a scale factor needs."""
LEAST_INTERVAL_ROWS = 3
"""Rows in every interval of a spline."""
LEAST_INTERVALS = 12
"""Of an automatic spline that is diagnosed: the misfit of a coarser curve looks like an effect."""
MOST_CONDITION = 1e12
"""Condition of the scaled columns above which their coefficients have lost all meaning."""
ON_BOUND = 1e-3
"""Share of a parameter's range at either end in which the data do not determine it."""

# What a diagnosis needs
TIE = 6.0
"""Candidates within this evidence of the best are not told apart by the data."""
WRONGLY_NAMED = 0.015
"""Share of simulated runs in which chance may name an effect; of real clean runs it is to be below 2 %."""
FURTHER_EVIDENCE = 10.0
"""Most evidence that a second effect needs: the first one's equation is never the whole truth, and its rest resembles
something."""
FURTHER_SHARE = 0.05
"""Share of the evidence of the others that a second effect needs. Beside one effect whose truth has another equation
(a lag of two nodes, a loop after Preisach) others reached 4 % of its evidence at most in 64 simulated units …"""
FURTHER_LEAST = 6.0
"""… and 5.6 at most beside two, in 85 simulated units; what begins at a place more."""
FURTHER_SLOW = 5.0
"""The same of a line in time, ageing: what is left of other equations follows the temperature and does not resemble it.
Beside one other effect it reached 3.9 at most in 93 simulated units without ageing."""
EXPLAINED_RATIO = 1.15
"""Error on unseen data over the noise floor up to which no formula is searched beside the effects that were found."""
FORMULA_EVIDENCE = 12.0
"""Evidence that a formula needs, which pays for the number of formulas tried, too."""
PAYS = 1e-3
"""Least relative fall of the held-out error that pays for an effect."""
NAMED_FALL = 0.02
"""Relative fall of the error on unseen data up to which an effect does not head an answer."""
BEYOND_DOUBT = 40.0
"""Evidence that chance never reaches."""
SHAPE_ALONE = 0.95
"""Share of an error, without the constants of its runs, below which these are worth a note."""
PROVED_FALL = 0.03
"""Least relative fall of the error on unseen data that proves an effect …"""
PROVED_DEVIATIONS = 2.0
"""… and the same in standard deviations of what noise alone does to it."""
PROVED_CHOSEN = 5.0
"""The same for a formula on rows that had a say in its choice: the best of 50,000 reaches about sqrt(2 ln 50000)."""
PREFERRED_FALL = 0.25
"""Relative fall of the error on unseen data with another effect in the place of one found, above which that one
is not proved …"""
PREFERRED_DEVIATIONS = 3.0
"""… and the same in standard deviations: of several others one may fall by luck."""
NEAREST_RATIO = 2.0
"""Error on unseen data over the noise floor above which what was found is the nearest entry of the catalogue only."""
STEPS_MATTER = 0.1
"""Error from steps of thermometer or output over the noise floor above which it may pass for an effect."""
LEAST_PRESENT = 0.7
"""Share of the rows in which the channels of effects need values together: rows with gaps are left out for all."""
LEAST_DIAGNOSED_ROWS = 16
"""Means of the runs together."""
LEAST_STATIC_ROWS = 40
"""Means of an isothermal run with the temperature standing still."""
CYCLES_DEGC = 3.0
"""Range of temperature within which a run that never settles counts as isothermal: its chamber cycles."""
LEAST_STRETCH_S = 300.0
"""Length of an isothermal stretch that the noise floor is read from."""

# What a calibration must keep to
ADEQUATE_RATIO = 1.5
"""Held-out error over the noise floor up to which nothing worth the effort is left to model."""
OVERFIT_RATIO = 2.0
"""Held-out error over the error in the fitted rows above which the model fits noise."""
MOST_EXTRAPOLATED = 0.05
"""Share of the unseen rows beyond the fitted range; above it the held-out error is one of extrapolation."""
NEAR_RANGE = 0.02
"""A row is beyond the fitted range if it is further from it than this share of it.

A run that visits its ends once never has them in the rest when their block is left out; the rest almost reaches them.
"""
MOST_LEFT_OUT = 0.01
"""Share of a run's data that may be no measurements; the rest of a run that lacks more is not trusted either."""
LEAST_BRANCH_S = 600.0
"""Time spent heating, and cooling, below which a difference between the two cannot be seen."""
MOST_STEP_SHARE = 0.5
"""Error from the steps of the temperature sensor over the held-out error: a quarter of its square."""
MOST_LOOP_RATIO = 6.0
"""Loop that the model leaves over the noise floor, where it is also more than half of the loop that was there."""
MOST_DELIVERED_CONDITION = 1e9
"""Condition of the scaled columns above which the coefficients depend on the last digits of the data."""
LEAST_COVERED_DEGC = 10.0
"""Range of temperature of a calibration, and of a scale factor that is fitted over temperature."""
WIDEST_HOLE = 0.35
"""Share of a channel's range that may lack data: between the points of a table, not beyond what a curve can bridge."""
MOST_MISSING_PPM = 1e4
"""Samples missing in a run that a verdict rests on, where its limits say nothing about them …"""
LONGEST_GAP_S = 60.0
"""… and its longest gap: two means. The gap between the parts of a resumed run is judged by itself."""
VERIFIED_RATIO = 1.2
"""Without limits the error of a corrected unit must stay below this times the noise floor."""
