"""The bytes of messages as values, by the definition of their type."""
