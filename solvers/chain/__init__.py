"""Any machine: the likelihood of a chain of joints, what of it can be told, and its solver."""
