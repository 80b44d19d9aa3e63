"""The browser app (``preshape view``): shows plans, makes new ones, teaches, and tests grips in physics."""
