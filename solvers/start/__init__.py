"""First answers and outliers: what a solver starts from, without a guess by the user."""
