"""Grasps in real physics: convex pieces, grasp arrays, and the six-direction holding test."""
