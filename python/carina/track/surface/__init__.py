"""Surface of the lumen: as a mesh, as an outline in a plane, and as a distance to the wall."""
