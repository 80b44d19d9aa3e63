"""Pictures without a display: a ray caster on the CPU, and the figures made with it."""
