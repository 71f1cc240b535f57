"""The command `carm-kin`: one file a command, and what all of them share.

Nothing else in the package prints, reads the keyboard or exits."""
