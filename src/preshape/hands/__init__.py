"""Hands: their descriptions, their kinematics and their collisions."""

from .hand import Finger, Hand
from .load import hand_names, load_hand, parse_hand

__all__ = ["Finger", "Hand", "hand_names", "load_hand", "parse_hand"]
