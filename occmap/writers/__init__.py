"""Writers: one file per map format, found through entry points and chosen by suffix.

A writer is a class with a `name`, a one-line `description`, its `suffixes`, and a
`write(path, map, options)` that returns the files it wrote.
"""
