"""What an estimate is worth: what the data determine, what does not fit, and why."""
