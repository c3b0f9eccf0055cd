"""Files as raw content: lines of text, or channels and the bytes of their messages."""
