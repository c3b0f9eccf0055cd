"""`occmap writers`: the map formats that can be written."""

from occmap.cli.listing import make_command

command = make_command("writers", "occmap.writers")
