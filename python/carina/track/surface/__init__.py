"""The surface of the lumen: as a mesh, as an outline in a plane, as a distance to the wall."""
