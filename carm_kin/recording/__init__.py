"""A recording: poses of the sensor, and what is known of the joints while they were taken.

`formats` has one file a format; `ingest` makes a recording of what a tracker's file says, `session` of several files,
`stations` of the stops in a stream."""
