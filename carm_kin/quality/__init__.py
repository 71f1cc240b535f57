"""Quality over time: dated calibrations of one machine and sensor, held against control limits."""
