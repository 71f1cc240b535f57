"""Systematic errors as random effects: what a machine that bends and a tracker that distorts add to the noise.

docs/estimation.md, "Systematic effects". `process` has smooth random functions, `columns` the effects, `blocks` the
poses in stretches, `rows` their equations, `variance` the restricted likelihood, `systematic` finds the effects, and
`allowed` has the estimate beside them.
"""
