"""The likelihood of the two-axis chain: its equations, the angles eliminated, covariances, the bound."""
