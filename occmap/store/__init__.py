"""Saved evidence: merged, rendered again, and kept in blocks for maps larger than memory.

A store is such evidence as a Zarr v3 folder. It is made block by block, by as many processes as
there are: `writing.create_store`, then `writing.write_block` and `writing.paint_block` for each
block, then `writing.finish_store`. It is read block by block, too: `reading.open_store`.
docs/formats.md says what is in it.
"""
