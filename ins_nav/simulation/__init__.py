"""Simulation: carriers' motion over the ellipsoid, sensors' errors, named scenarios, recordings of them."""
