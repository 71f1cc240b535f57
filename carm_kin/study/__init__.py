"""Solvers side by side: on one recording, over simulated ones, and in the experiments of the paper."""
