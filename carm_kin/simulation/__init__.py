"""Simulated recordings with their truth: what moves (`protocols`), how it is disturbed (`noise`), what is true."""
