"""Vehicles that nobody has prepared: made here, by a simulation and an encoder that are not the product's."""
