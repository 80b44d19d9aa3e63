"""Plans in the formats of other programs: MoveIt messages, MuJoCo scenes, grasp arrays."""
