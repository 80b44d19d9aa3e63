"""The task test: the hand moves the object through the task against a load (ENGINE §4)."""
