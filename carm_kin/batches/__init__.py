"""Many recordings: which ones, on which workers, what was done already, and what came out."""
