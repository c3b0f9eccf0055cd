"""Raw content as values: messages by the definition of their type, lines by their pattern."""
