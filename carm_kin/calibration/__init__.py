"""From a recording to a result: recording -> problem -> solver -> verdict -> result.

`settings` says how a recording is calibrated; `chain` does the same for a URDF's whole chain."""
