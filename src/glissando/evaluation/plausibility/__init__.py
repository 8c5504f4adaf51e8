"""Whether readings can be what they are said to be: units, clocks, frames, axes, noise."""
