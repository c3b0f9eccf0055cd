"""`occmap models`: the sensor models that are installed, with their parameters."""

from occmap.cli.listing import make_command

command = make_command("models", "occmap.models")
