"""Plans for other programs: MoveIt messages, MuJoCo scenes, grasp arrays."""
