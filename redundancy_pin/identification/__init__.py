"""Identification of closed chains: masses, inertias and friction from measured motions."""
