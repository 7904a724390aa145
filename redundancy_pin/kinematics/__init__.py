"""Kinematics of closed chains: closures, branches, modes and singularities."""
