"""The pick test: the hand takes an object from a table, lifts it and holds it."""
