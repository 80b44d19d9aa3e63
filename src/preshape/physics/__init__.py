"""Grasps in simulated physics: convex pieces, grasp arrays, the holding test and the task test."""
