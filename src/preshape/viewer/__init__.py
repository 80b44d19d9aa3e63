"""Pictures and web pages from plain values: a CPU ray caster, figures, and one drawing for every canvas."""
