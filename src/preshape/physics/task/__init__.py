"""The task test: the hand moves the object through a task, against a load (ENGINE §4)."""
