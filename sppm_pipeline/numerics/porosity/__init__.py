"""Reaching a target porosity (paper, section 2.3).

From coarse to fine: `line` (the number of pores from a fitted line), `bracket` (a search on one design parameter),
`level` (the level as a quantile of the field, exact in one pass); `box_stats` sums up the spread of many draws.
"""
