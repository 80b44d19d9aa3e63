"""The task test: the hand moves the object along a task's motion, against a load (ENGINE §4)."""
