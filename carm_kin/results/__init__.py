"""What comes out of the program, as values, as JSON and in words.

`result` is a calibration; the other results stand beside it. `summary` prints them."""
