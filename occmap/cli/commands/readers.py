"""`occmap readers`: the log formats that can be read."""

from occmap.cli.listing import make_command

command = make_command("readers", "occmap.readers")
