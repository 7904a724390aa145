"""The files robots are written in, each read into a tree or a ``Mechanism``: URDF, xacro, MJCF, SDF, others."""
