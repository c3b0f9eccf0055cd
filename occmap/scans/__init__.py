"""The steps of a build: from the path of a log to what its scans observe.

`tracing.trace` lists the way of a scan. `check`, `compare`, `tune` and `explain` go it, too.
"""
