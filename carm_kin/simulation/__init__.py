"""Simulated recordings with their truth: what moves (`protocols`), what it does besides (`effects`), noise, truth."""
