"""The commands of `occmap`, one module each; what they share stands one level up."""
