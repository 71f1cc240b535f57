"""Live trackers: what a server sends is read, stored, watched, and sent again from a recording."""
