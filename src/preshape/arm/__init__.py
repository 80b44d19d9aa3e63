"""The arm that carries the hand: its model, inverse kinematics, collisions, and whether it reaches a grasp.

The frame of this package is the arm's base, the root link of a URDF, unless a name says otherwise.
"""
