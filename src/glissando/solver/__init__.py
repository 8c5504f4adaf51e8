"""From factors to a step: linearise, assemble, factor, solve."""
