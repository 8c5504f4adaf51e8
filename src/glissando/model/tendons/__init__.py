"""Tendons: their channels, elasticity and friction, and the shapes of rods that they pull."""
